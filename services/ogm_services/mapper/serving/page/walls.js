// Where the walls are: the region that holds the occupied cells, but for stray ones, by overviews of the map.
import {ask} from "./ask.js";
import {LEVELS, NATIVE_Z, SIZE} from "./constants.js";

const TILES = 6;  // at most so many are looked at
const STRAY = 0.005;  // so small a share of the occupied pixels may lie beyond each side
const ROOM = 0.05;  // of the region, beyond each side, for walls that were taken for stray cells

// The least coarse tiles that cover an extent.
function covering({extent: [x0, y0, x1, y1], resolution, anchor: [ax, ay]}) {
  for (let z = NATIVE_Z; ; z--) {
    const pixel = resolution * 2 ** (NATIVE_Z - z), tile = SIZE * pixel;
    const [left, right] = [Math.floor((x0 - ax) / tile), Math.ceil((x1 - ax) / tile)];
    const [top, bottom] = [Math.floor((ay - y1) / tile), Math.ceil((ay - y0) / tile)];
    if ((right - left) * (bottom - top) <= TILES || z === NATIVE_Z - LEVELS) return {z, pixel, left, right, top, bottom};
  }
}

// Calls `found(u, v)` with each pixel of a tile that is occupied.
async function eachOccupied(path, found) {
  const reply = await ask(`${path}?palette=ros`);
  if (!reply.ok) throw new Error(`${path}: ${reply.status}`);
  const bitmap = await createImageBitmap(await reply.blob());
  const pen = new OffscreenCanvas(SIZE, SIZE).getContext("2d");
  pen.drawImage(bitmap, 0, 0);
  bitmap.close();
  const pixels = new Uint32Array(pen.getImageData(0, 0, SIZE, SIZE).data.buffer);
  for (let at = 0; at < pixels.length; at++) {
    // Black, and not transparent.
    if (pixels[at] === 0xff000000) found(at % SIZE, Math.floor(at / SIZE));
  }
}

// From where to where most of what is counted lies: [first, beyond the last], by counts in a row.
export function span(counts) {
  const total = counts.reduce((sum, count) => sum + count, 0);
  let low = 0, high = counts.length, below = counts[0], above = counts.at(-1);
  while (below <= STRAY * total) below += counts[++low];
  while (above <= STRAY * total) above += counts[--high - 1];
  const room = Math.ceil(ROOM * (high - low));
  const first = counts.findIndex((count) => count > 0), last = counts.findLastIndex((count) => count > 0);
  return [Math.max(low - room, first), Math.min(high + room, last + 1)];
}

// [xmin, ymin, xmax, ymax] in metres, to a pixel of the overview; the map's extent if there are no walls.
export async function wallsOf(told) {
  const {z, pixel, left, right, top, bottom} = covering(told), places = [];
  for (let x = left; x < right; x++) for (let y = top; y < bottom; y++) places.push([x, y]);
  const columns = new Array(SIZE * (right - left)).fill(0), rows = new Array(SIZE * (bottom - top)).fill(0);
  await Promise.all(places.map(([x, y]) => eachOccupied(`tiles/${z}/${x}/${y}.png`, (u, v) => {
    columns[SIZE * (x - left) + u] += 1;
    rows[SIZE * (y - top) + v] += 1;
  })));
  if (!columns.some(Boolean)) return told.extent;
  const [u0, u1] = span(columns), [v0, v1] = span(rows), [ax, ay] = told.anchor;
  return [
    ax + pixel * (SIZE * left + u0), ay - pixel * (SIZE * top + v1),
    ax + pixel * (SIZE * left + u1), ay - pixel * (SIZE * top + v0),
  ];
}

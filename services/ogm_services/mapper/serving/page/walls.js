// Where the walls are: the region that holds all occupied cells, by overviews of the map.
import {ask} from "./ask.js";
import {LEVELS, NATIVE_Z} from "./view.js";

const SIZE = 256, TILES = 6;  // at most so many are looked at

// The least coarse tiles that cover an extent.
function covering({extent: [x0, y0, x1, y1], resolution, anchor: [ax, ay]}) {
  for (let z = NATIVE_Z; ; z--) {
    const pixel = resolution * 2 ** (NATIVE_Z - z), tile = SIZE * pixel;
    const [left, right] = [Math.floor((x0 - ax) / tile), Math.ceil((x1 - ax) / tile)];
    const [top, bottom] = [Math.floor((ay - y1) / tile), Math.ceil((ay - y0) / tile)];
    if ((right - left) * (bottom - top) <= TILES || z === NATIVE_Z - LEVELS) return {z, pixel, left, right, top, bottom};
  }
}

// First and last column and row of a tile's pixels that are occupied; null: none is.
async function occupied(path) {
  const reply = await ask(`${path}?palette=ros`);
  if (!reply.ok) throw new Error(`${path}: ${reply.status}`);
  const bitmap = await createImageBitmap(await reply.blob());
  const pen = new OffscreenCanvas(SIZE, SIZE).getContext("2d");
  pen.drawImage(bitmap, 0, 0);
  bitmap.close();
  const pixels = new Uint32Array(pen.getImageData(0, 0, SIZE, SIZE).data.buffer);
  let [u0, v0, u1, v1] = [SIZE, SIZE, -1, -1];
  for (let at = 0; at < pixels.length; at++) {
    if (pixels[at] !== 0xff000000) continue;  // black, and not transparent
    const u = at % SIZE, v = (at - u) / SIZE;
    u0 = Math.min(u0, u); u1 = Math.max(u1, u); v0 = Math.min(v0, v); v1 = Math.max(v1, v);
  }
  return u1 < 0 ? null : [u0, v0, u1 + 1, v1 + 1];
}

// [xmin, ymin, xmax, ymax] in metres, to a pixel of the overview; the map's extent if there are no walls.
export async function wallsOf(told) {
  const {z, pixel, left, right, top, bottom} = covering(told), places = [];
  for (let x = left; x < right; x++) for (let y = top; y < bottom; y++) places.push([x, y]);
  const found = (await Promise.all(places.map(async ([x, y]) => {
    const box = await occupied(`tiles/${z}/${x}/${y}.png`);
    return box?.map((at, k) => at + SIZE * (k % 2 ? y : x));
  }))).filter(Boolean);
  if (!found.length) return told.extent;
  const side = (k, extreme) => extreme(...found.map((box) => box[k])), [ax, ay] = told.anchor;
  return [
    ax + pixel * side(0, Math.min), ay - pixel * side(3, Math.max),
    ax + pixel * side(2, Math.max), ay - pixel * side(1, Math.min),
  ];
}

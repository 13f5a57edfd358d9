// The view of the map: Leaflet pans and zooms it, in metres of the map frame; zoom 0 is a pixel a cell.
import {LEVELS, MAX_VIEW_TILES, NATIVE_Z, SIZE} from "./constants.js";

const {L} = globalThis;

const still = matchMedia("(prefers-reduced-motion: reduce)");
export const place = (x, y) => L.latLng(y, x);

function crsOf({resolution, anchor: [x, y]}) {
  const scale = 1 / resolution;
  return L.extend({}, L.CRS.Simple, {transformation: new L.Transformation(scale, -x * scale, -scale, y * scale)});
}

export class View {
  constructor(container, told) {
    this.map = L.map(container, {
      crs: crsOf(told), minZoom: -LEVELS, maxZoom: 6, zoomSnap: 0.25, zoomDelta: 1, zoomAnimation: false,
      fadeAnimation: false, markerZoomAnimation: false, attributionControl: false, zoomControl: false,
      inertia: !still.matches, boxZoom: false, doubleClickZoom: false, wheelPxPerZoomLevel: 90,
      center: place(...told.anchor), zoom: 0,
    });
    this.told = told;
    this.quiet = false;  // whether the page itself moves the view
    this.touched = false;  // whether somebody has moved it
    this.map.on("movestart zoomstart", () => { this.touched ||= !this.quiet; });
    if (still.matches) this.map.panBy = (by) => L.Map.prototype.panBy.call(this.map, by, {animate: false});
  }

  // The map has another resolution or anchor.
  tell(told) {
    const {resolution, anchor} = this.told, [x, y] = anchor;
    this.told = told;
    if (told.resolution === resolution && told.anchor[0] === x && told.anchor[1] === y) return;
    const {map} = this, centre = map.getCenter(), zoom = map.getZoom();
    map.options.crs = crsOf(told);
    this.quietly(() => map.setView(centre, zoom, {animate: false, reset: true}));
  }

  // What the page does to the view is nobody's wish to keep it as it is.
  quietly(move) {
    this.quiet = true;
    try { move(); } finally { this.quiet = false; }
  }

  // Show all of a region [xmin, ymin, xmax, ymax], with some room for what lies over the map.
  fit([x0, y0, x1, y1]) {
    const {x: width} = this.map.getSize(), wide = width > 500;
    this.quietly(() => this.map.fitBounds([[y0, x0], [y1, x1]], {
      animate: false, maxZoom: 4, paddingTopLeft: wide ? [60, 24] : [12, 60], paddingBottomRight: wide ? [24, 36] : [12, 40],
    }));
  }

  centreOn(x, y, zoom = this.map.getZoom()) {
    this.quietly(() => this.map.setView(place(x, y), zoom, {animate: false}));
  }

  // Where everything lies on the canvas now; u to the right and v down, CSS pixels.
  now() {
    const {map, told: {resolution, anchor: [ax, ay]}} = this;
    const {min} = map.getPixelBounds(), {x: width, y: height} = map.getSize(), zoom = map.getZoom();
    const cell = 2 ** zoom, metre = cell / resolution;
    return {
      width, height, zoom, cell, metre, left: min.x, top: min.y,
      toCanvas: (x, y) => [(x - ax) * metre - min.x, (ay - y) * metre - min.y],
      toWorld: (u, v) => [ax + (u + min.x) / metre, ay - (v + min.y) / metre],
    };
  }
}

// The tiles that a view shows, and `margin` more around: their z, and the first and last of x and y. At most MAX_VIEW_TILES:
// on a large screen they are shown smaller than pixel by pixel.
export function tilesOf(view, ratio, margin = 0) {
  const {zoom, width, height, left, top} = view;
  const wanted = Math.min(0, Math.max(-LEVELS, Math.round(zoom + Math.log2(ratio))));
  for (let level = wanted; ; level--) {
    const side = SIZE * 2 ** (zoom - level), last = level === -LEVELS;
    const x0 = Math.floor(left / side) - margin, x1 = Math.ceil((left + width) / side) - 1 + margin;
    const y0 = Math.floor(top / side) - margin, y1 = Math.ceil((top + height) / side) - 1 + margin;
    if (last || (x1 - x0 + 1) * (y1 - y0 + 1) <= MAX_VIEW_TILES) return {z: NATIVE_Z + level, side, x0, x1, y0, y1};
  }
}

// [z, x, y] of each, those in the middle first.
export function placesOf({z, x0, y0, x1, y1}) {
  const places = [];
  for (let x = x0; x <= x1; x++) for (let y = y0; y <= y1; y++) places.push([z, x, y]);
  const off = ([, x, y]) => Math.hypot(2 * x - x0 - x1, 2 * y - y0 - y1);
  return places.sort((one, other) => off(one) - off(other));
}

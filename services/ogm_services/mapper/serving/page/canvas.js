// The one canvas that shows the map, drawn in one frame whenever something of it has changed.
import {LEVELS, NATIVE_Z, SIZE} from "./constants.js";
import {state} from "./state.js";
import {tilesOf} from "./view.js";

export class MapCanvas {
  constructor(view, tiles) {
    this.view = view;
    this.tiles = tiles;
    // What is drawn, from below to above: {name, draw(pen, view)} in CSS pixels. `state.layers` says which
    // are shown, by name, and how opaque they are.
    this.layers = [{name: "map", draw: (pen, now) => this.drawTiles(pen, now)}];
    this.frame = 0;
    this.canvas = document.createElement("canvas");
    view.map.getContainer().append(this.canvas);
    view.map.on("move zoom resize viewreset", () => this.redraw());
  }

  redraw() {
    this.frame ||= requestAnimationFrame(() => {
      this.frame = 0;
      this.draw(this.canvas);
    });
  }

  // Draw on any canvas as the view is now.
  draw(canvas, ground = null) {
    const now = this.view.now(), ratio = devicePixelRatio;
    const width = Math.round(now.width * ratio), height = Math.round(now.height * ratio);
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, {width, height});
    const pen = canvas.getContext("2d");
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.clearRect(0, 0, width, height);
    if (ground) {
      pen.fillStyle = ground;
      pen.fillRect(0, 0, width, height);
    }
    this.tiles.draws += 1;
    for (const layer of this.layers) {
      const {shown = true, opacity = 1} = state.layers[layer.name] ?? {};
      if (!shown) continue;
      pen.save();
      pen.scale(ratio, ratio);
      pen.globalAlpha = opacity;
      layer.draw(pen, now);
      pen.restore();
    }
  }

  drawTiles(pen, now) {
    if (!state.map?.extent) return;
    const ratio = devicePixelRatio, {z, side, x0, x1, y0, y1} = tilesOf(now, ratio);
    pen.setTransform(1, 0, 0, 1, 0, 0);
    // A cell is a square of its own from native up; what is shrunk further keeps its thin walls.
    pen.imageSmoothingEnabled = side * ratio < SIZE;
    // Edges on whole pixels: there are no seams.
    const edge = (n, from) => Math.round((n * side - from) * ratio);
    for (let x = x0; x <= x1; x++) {
      const u = edge(x, now.left), width = edge(x + 1, now.left) - u;
      for (let y = y0; y <= y1; y++) {
        const v = edge(y, now.top), height = edge(y + 1, now.top) - v;
        this.drawTile(pen, [z, x, y], [u, v, width, height]);
      }
    }
  }

  // A tile, or what is held of coarser and finer ones while it is on its way.
  drawTile(pen, [z, x, y], [u, v, width, height]) {
    const picture = this.tiles.picture(z, x, y);
    if (picture) pen.drawImage(picture, u, v, width, height);
    if (picture !== undefined) return;
    for (let up = 1; up <= LEVELS && z - up >= NATIVE_Z - LEVELS; up++) {
      const coarser = this.tiles.picture(z - up, x >> up, y >> up), part = SIZE >> up;
      if (coarser === undefined) continue;
      const [s, t] = [(x - ((x >> up) << up)) * part, (y - ((y >> up) << up)) * part];
      if (coarser) pen.drawImage(coarser, s, t, part, part, u, v, width, height);
      break;
    }
    if (z === NATIVE_Z) return;
    for (const [right, below] of [[0, 0], [1, 0], [0, 1], [1, 1]]) {
      const finer = this.tiles.picture(z + 1, 2 * x + right, 2 * y + below);
      if (finer) pen.drawImage(finer, u + right * width / 2, v + below * height / 2, width / 2, height / 2);
    }
  }
}

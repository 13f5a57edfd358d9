// Fits the view to the walls, or to all of the map, and keeps it so while the map grows and nobody moves it.
import {state} from "./state.js";
import {wallsOf} from "./walls.js";

const AGAIN_MS = 2000;

export class Fitting {
  constructor(view) {
    this.view = view;
    this.fitted = null;  // the region that was fitted
    this.looked = -Infinity;
    view.map.on("resize", () => { if (this.fitted && !view.touched) view.fit(this.fitted); });
  }

  // To the walls: long beams that met nothing do not count.
  async walls() {
    if (!state.map.extent) return;
    this.looked = performance.now();
    this.fit(await wallsOf(state.map).catch(() => state.map.extent));
  }

  all() {
    if (state.map.extent) this.fit(state.map.extent);
  }

  fit(region) {
    this.fitted = region;
    this.view.touched = false;
    this.view.fit(region);
  }

  forget() { this.fitted = null; }

  // The map may have grown.
  async keep() {
    if (this.view.touched || state.followed || !state.map.extent) return;
    if (!this.fitted) return this.walls();
    if (performance.now() - this.looked < AGAIN_MS) return;
    this.looked = performance.now();
    const found = await wallsOf(state.map).catch(() => null), [x0, y0, x1, y1] = this.fitted;
    if (!found || this.view.touched) return;
    const slack = 0.02 * Math.max(x1 - x0, y1 - y0);
    const grown = found[0] < x0 - slack || found[1] < y0 - slack || found[2] > x1 + slack || found[3] > y1 + slack;
    if (grown) this.fit(found);
  }
}

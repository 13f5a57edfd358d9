// The live page: makes its parts and tells them of each other.
import {MapCanvas} from "./canvas.js";
import {startCurves} from "./curves.js";
import {startLink} from "./link.js";
import {namesLayer, robotsLayer} from "./overlay.js";
import {startPalettes} from "./palettes.js";
import {startPanel} from "./panel.js";
import {startReadout} from "./readout.js";
import {scaleLayer} from "./scale.js";
import {state, subscribe} from "./state.js";
import {element} from "./tables.js";
import {Tiles} from "./tiles.js";
import {View, placesOf, tilesOf} from "./view.js";

const page = {view: null, canvas: null, tiles: null, touched: false, state};
let before = null;  // the map that was told of last

// The map view begins when the mapper has said where the map lies.
function start(told) {
  page.view = new View(element("map"), told);
  page.tiles = new Tiles(() => page.canvas?.redraw());
  page.canvas = new MapCanvas(page.view, page.tiles);
  page.canvas.layers.push(robotsLayer, namesLayer, scaleLayer);
  page.view.map.on("moveend resize", wantTiles);
  element("map").addEventListener("pointerdown", () => { page.touched = true; });
  element("map").addEventListener("wheel", () => { page.touched = true; });
  startReadout(page.view);
}

function wantTiles() {
  if (state.map.extent) page.tiles.want(placesOf(tilesOf(page.view.now(), devicePixelRatio, 1)));
}

function follow(told) {
  if (!page.view) start(told);
  page.view.tell(told);
  if (before && before.epoch !== told.epoch) page.tiles.forget();
  else if (before && before.run !== told.run) page.tiles.forgetRevisions();
  const grown = String(before?.extent) !== String(told.extent);
  before = told;
  if (told.extent && grown && !page.touched) page.view.fit(told.extent);
  wantTiles();
  page.canvas.redraw();
}

startPalettes();
startPanel();
startCurves();
subscribe("map", follow);
subscribe("palette", () => { page.tiles?.forget(); page.view && wantTiles(); });
for (const part of ["robots", "scans", "layers"]) subscribe(part, () => page.canvas?.redraw());
globalThis.ogm = page;  // for who looks at it from the browser's console
startLink();

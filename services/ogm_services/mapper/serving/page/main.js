// The live page: makes its parts and tells them of each other.
import {startBanner} from "./banner.js";
import {MapCanvas} from "./canvas.js";
import {startChanges} from "./changes.js";
import {startCurves} from "./curves.js";
import {EraseTool} from "./erase.js";
import {Fitting} from "./fitting.js";
import {startFollow} from "./follow.js";
import {gridLayer} from "./grid.js";
import {startLayers} from "./layers.js";
import {Link} from "./link.js";
import {measureLayer, startMeasure} from "./measure.js";
import {missingLayer, startMissing} from "./missing.js";
import {namesLayer, robotsLayer} from "./overlay.js";
import {startPalettes} from "./palettes.js";
import {startPanel} from "./panel.js";
import {startPermalink} from "./permalink.js";
import {pointLayer, startReadout} from "./readout.js";
import {scaleLayer} from "./scale.js";
import {scansLayer} from "./scans.js";
import {state, subscribe} from "./state.js";
import {element} from "./tables.js";
import {Tiles} from "./tiles.js";
import {startTools} from "./tools.js";
import {forgetTrails, startTrails, trailsLayer} from "./trails.js";
import {troubleLayer} from "./trouble_layer.js";
import {startTroubles} from "./troubles.js";
import {View, placesOf, tilesOf} from "./view.js";

const page = {view: null, canvas: null, tiles: null, fitting: null, link: null, state};
let before = null;  // the map that was told of last
let wanted = "";  // which tiles are

// The map view begins when the mapper has said where the map lies.
function start(told) {
  const view = page.view = new View(element("map"), told);
  page.tiles = new Tiles(() => page.canvas?.redraw());
  const canvas = page.canvas = new MapCanvas(view, page.tiles), redraw = () => canvas.redraw();
  canvas.layers.push(
    missingLayer, gridLayer, trailsLayer, scansLayer, robotsLayer, namesLayer, troubleLayer, measureLayer, pointLayer,
    scaleLayer);
  page.fitting = new Fitting(view);
  view.map.on("move zoom resize", wantTiles);
  startMeasure(view, redraw);
  page.unpin = startReadout(view, redraw);
  startFollow(view);
  startTools(page);
  startPermalink(view);
  startChanges(new EraseTool(view, canvas));
  page.link.live.awaitAll();
}

function wantTiles() {
  // Before it is known where to look nothing is looked at.
  if (!state.map.extent || !(page.fitting.fitted || page.view.touched)) return;
  const rectangle = tilesOf(page.view.now(), devicePixelRatio, 1), asked = JSON.stringify(rectangle);
  if (asked === wanted) return page.tiles.refresh();
  wanted = asked;
  page.link.live.show(rectangle);
  page.tiles.want(placesOf(rectangle));
}

function follow(told) {
  if (!page.view) start(told);
  page.view.tell(told);
  if (before && before.epoch !== told.epoch) {
    page.tiles.forget();
    page.fitting.forget();
    forgetTrails();
    wanted = "";
  } else if (before && before.run !== told.run) page.tiles.forgetRevisions();
  before = told;
  page.fitting.keep();
  wantTiles();
  page.canvas.redraw();
}

startPalettes();
startTroubles();
startPanel();
startMissing(() => page.canvas?.redraw());
startBanner();
startLayers();
startCurves();
startTrails();
subscribe("map", follow);
subscribe("palette", () => { page.tiles?.forget(); if (page.view) wantTiles(); });
for (const part of ["robots", "scans", "layers"]) subscribe(part, () => page.canvas?.redraw());
globalThis.ogm = page;  // for who looks at it from the browser's console
page.link = new Link(() => page.tiles);
page.link.start();

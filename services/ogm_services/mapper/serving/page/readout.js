// What lies under the pointer, or in the middle of the view where there is none, and the point that was clicked.
import {askJson} from "./ask.js";
import {FREE_BELOW, OCCUPIED_ABOVE} from "./constants.js";
import {copy} from "./copying.js";
import {ground, mark} from "./overlay.js";
import {state, subscribe} from "./state.js";
import {element} from "./tables.js";

const EVERY_MS = 80, AGAIN_MS = 500;
const coarse = matchMedia("(pointer: coarse)");
let fingers = coarse.matches;  // kept: to ask for it in each frame costs more than all else that is drawn
let pointer = null;  // [u, v] on the canvas, CSS pixels
let pinned = null;  // [x, y] in metres
let timer = 0, asked = 0, shown = 0;

const said = ([x, y]) => `${x.toFixed(3)}, ${y.toFixed(3)}`;
const meaning = ({known, probability}) =>
  !known ? "unknown" : probability > OCCUPIED_ABOVE ? "occupied" : probability < FREE_BELOW ? "free" : "undecided";

// By keyboard or with fingers one points with the middle of the view.
const byMiddle = () => !pointer && (fingers || document.activeElement === element("map"));

function show(lines) {
  element("place").replaceChildren(...lines.map((text) => {
    const line = document.createElement("div");
    line.append(text);
    return line;
  }));
  element("pin").hidden = !pinned;
  if (pinned) element("pinned").textContent = `${pinned[0].toFixed(2)}, ${pinned[1].toFixed(2)} m`;
  element("readout").hidden = !lines.length && !pinned;
}

function pointed(view) {
  const now = view.now();
  return pointer ? now.toWorld(...pointer) : byMiddle() ? now.toWorld(now.width / 2, now.height / 2) : null;
}

async function refresh(view) {
  timer = 0;
  const at = state.map.extent && pointed(view), turn = ++asked;
  if (!at) { shown = turn; show([]); return; }
  const [x, y] = at, lines = [`${x.toFixed(2)}, ${y.toFixed(2)} m`];
  try {
    const cell = await askJson(`cell?x=${x.toFixed(6)}&y=${y.toFixed(6)}`);
    lines.push(`cell ${cell.ix}, ${cell.iy}`, cell.known ? `p ${cell.probability.toFixed(3)} ${meaning(cell)}` : "unknown");
  } catch {
    // Where it is can be said at least.
  }
  if (turn < shown) return;  // a newer answer is shown
  shown = turn;
  show(lines);
}

export const copyPlace = (view) => {
  const at = pinned ?? pointed(view);
  if (at) copy(said(at), `${said(at)} m`);
};

function cross(pen, [u, v], size) {
  for (const [lineWidth, strokeStyle] of [[3.5, ground()], [1.5, mark()]]) {
    Object.assign(pen, {lineWidth, strokeStyle});
    pen.beginPath();
    pen.moveTo(u - size, v); pen.lineTo(u + size, v); pen.moveTo(u, v - size); pen.lineTo(u, v + size);
    pen.stroke();
  }
}

export const pointLayer = {
  name: "point",
  draw(pen, view) {
    if (pinned) cross(pen, view.toCanvas(...pinned), 7);
    if (byMiddle() && state.map.extent) cross(pen, [view.width / 2, view.height / 2], 10);
  },
};

export function startReadout(view, redraw) {
  const soon = (delay = EVERY_MS) => { timer ||= setTimeout(() => refresh(view), delay); };
  const pin = (at) => { pinned = at; redraw(); soon(0); };
  // The middle of the pixel that is pointed at: its edge may be another cell's.
  view.map.on("mousemove", ({containerPoint: {x, y}}) => {
    pointer = fingers ? null : [x + 0.5, y + 0.5];
    soon();
  });
  coarse.addEventListener("change", () => { fingers = coarse.matches; });
  view.map.on("mouseout", () => { pointer = null; soon(0); });
  view.map.on("move zoom", () => soon());
  view.map.on("click", ({latlng: {lat: y, lng: x}}) => { if (!state.tool) pin([x, y]); });
  for (const event of ["focus", "blur"]) element("map").addEventListener(event, () => { redraw(); soon(0); });
  element("copy").addEventListener("click", () => copyPlace(view));
  subscribe("tool", () => pin(null));
  setInterval(() => (pointer || byMiddle()) && !document.hidden && soon(0), AGAIN_MS);
  soon(0);
  return () => pin(null);
}

// What lies under the pointer: where it is, which cell, and how likely that is occupied.
import {askJson} from "./ask.js";
import {isEmpty} from "./view.js";
import {element} from "./tables.js";

const EVERY_MS = 80, AGAIN_MS = 500;
let pointer = null;  // [u, v] on the canvas, CSS pixels
let timer = 0, asked = 0, shown = 0;

function show(texts) {
  element("readout").replaceChildren(...texts.map((text) => {
    const line = document.createElement("div");
    line.append(text);
    return line;
  }));
}

const stateOf = ({known, probability}) =>
  !known ? "unknown" : probability > 0.65 ? "occupied" : probability < 0.196 ? "free" : "undecided";

async function refresh(view) {
  timer = 0;
  if (!pointer || isEmpty()) { show([]); return; }
  const [x, y] = view.now().toWorld(...pointer), turn = ++asked;
  try {
    const cell = await askJson(`cell?x=${x.toFixed(6)}&y=${y.toFixed(6)}`);
    if (turn < shown || !pointer) return;  // a newer answer is shown
    shown = turn;
    show([
      `${x.toFixed(2)}, ${y.toFixed(2)} m`, `cell ${cell.ix}, ${cell.iy}`,
      cell.known ? `p ${cell.probability.toFixed(3)} ${stateOf(cell)}` : "unknown",
    ]);
  } catch {
    show([`${x.toFixed(2)}, ${y.toFixed(2)} m`]);
  }
}

export function startReadout(view) {
  const soon = (delay) => { timer ||= setTimeout(() => refresh(view), delay); };
  view.map.on("mousemove", ({containerPoint: {x, y}}) => { pointer = [x, y]; soon(EVERY_MS); });
  view.map.on("mouseout", () => { pointer = null; soon(0); });
  setInterval(() => pointer && soon(0), AGAIN_MS);
}

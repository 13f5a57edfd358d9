// Buttons over the map, and the keys that do the same.
import {copy, savePicture} from "./copying.js";
import {followNext} from "./follow.js";
import {toggleMeasure} from "./measure.js";
import {linkTo} from "./permalink.js";
import {copyPlace} from "./readout.js";
import {change, state, subscribe} from "./state.js";
import {element} from "./tables.js";

const say = (text) => { element("said").textContent = text; };

export function toggleLayer(name) {
  const layer = state.layers[name] ?? {};
  change("layers", {...state.layers, [name]: {...layer, shown: !(layer.shown ?? true)}});
}

// [key, what it does, its icon's path on 16 x 16, action, whether it is on]
const toolsOf = ({view, canvas, fitting}) => [
  ["+", "zoom in", "M8 3v10M3 8h10", () => view.map.zoomIn()],
  ["-", "zoom out", "M3 8h10", () => view.map.zoomOut()],
  ["f", "fit the walls", "M2 6V2h4M10 2h4v4M14 10v4h-4M6 14H2v-4M5.5 5.5h5v5h-5z", () => fitting.walls()],
  ["a", "fit all of the map", "M2 6V2h4M10 2h4v4M14 10v4h-4M6 14H2v-4", () => fitting.all()],
  ["r", "follow the next robot", "M8 2.5 12.5 13 8 10.5 3.5 13z", followNext, ["followed", () => state.followed !== null]],
  ["m", "measure", "M2 11.5 11.5 2 14 4.5 4.5 14zM5 8.5l1.5 1.5M8 5.5 9.5 7", toggleMeasure, ["tool", () => state.tool === "measure"]],
  ["g", "grid in metres", "M6 2v12M10.5 2v12M2 6h12M2 10.5h12", () => toggleLayer("grid"), ["layers", () => state.layers.grid.shown]],
  ["l", "copy a link to this view", "M6.5 9.5l3-3M7 5l1.5-1.5a2.5 2.5 0 0 1 4 4L11 9M9 11l-1.5 1.5a2.5 2.5 0 0 1-4-4L5 7",
    () => copy(linkTo(view), "a link to this view")],
  ["p", "save as a picture", "M8 2v8M4.5 7 8 10.5 11.5 7M2.5 13.5h11", () => savePicture(canvas)],
  ["w", "full screen", "M9.5 2H14v4.5M14 2 9.5 6.5M6.5 14H2V9.5M2 14l4.5-4.5", toggleFullScreen],
];

function toggleFullScreen() {
  if (document.fullscreenElement) document.exitFullscreen();
  else element("view").requestFullscreen?.();
}

function button([key, name, path, act, toggled]) {
  const made = document.createElement("button");
  made.type = "button";
  made.title = `${name} (${key})`;
  made.setAttribute("aria-label", name);
  made.setAttribute("aria-keyshortcuts", key);
  made.dataset.key = key;
  made.innerHTML = `<svg viewBox="0 0 16 16" aria-hidden="true"><path d="${path}"/></svg>`;
  made.addEventListener("click", act);
  if (toggled) {
    const [part, isOn] = toggled, show = () => made.setAttribute("aria-pressed", String(isOn()));
    subscribe(part, show);
    show();
  }
  return made;
}

export function startTools(page) {
  const tools = toolsOf(page);
  element("tools").replaceChildren(...tools.map(button));
  const keys = new Map(tools.slice(2).map(([key, , , act]) => [key, act]));
  keys.set("c", () => copyPlace(page.view));
  keys.set("Escape", () => {
    page.unpin();
    if (state.tool) change("tool", null);
    if (state.followed !== null) change("followed", null);
  });
  addEventListener("keydown", (event) => {
    const typing = event.target.closest("input, select, textarea, dialog");
    const act = keys.get(event.key);
    if (!act || typing || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    act();
  });
  subscribe("tool", (tool) => { element("map").dataset.tool = tool ?? ""; });
  subscribe("followed", (name) => say(name === null ? "no robot is followed" : `${name} is followed`));
}

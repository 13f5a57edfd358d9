// The switches of what is drawn on the map, and how opaque it is; the browser remembers them.
import {make} from "./elements.js";
import {change, state, subscribe} from "./state.js";
import {element} from "./tables.js";

const KEPT_AS = "ogm.layers";
// By name of a canvas layer; `opacity` is what it begins with, null: it is there or not.
const LAYERS = [
  {name: "map", label: "map", opacity: 1},
  {name: "grid", label: "grid lines", opacity: 0.6, shown: false},
  {name: "trails", label: "trails", opacity: 0.8},
  {name: "scans", label: "last scans", opacity: 0.6},
  {name: "names", label: "names", opacity: null},
];

function kept() {
  try {
    return JSON.parse(localStorage.getItem(KEPT_AS)) ?? {};
  } catch {
    return {};  // nothing is kept for this page, or not by it
  }
}

function keep() {
  try {
    localStorage.setItem(KEPT_AS, JSON.stringify(state.layers));
  } catch {
    // It is a convenience.
  }
}

function set(name, what) {
  change("layers", {...state.layers, [name]: {...state.layers[name], ...what}});
}

function row({name, label, opacity}) {
  const shown = make("input", {type: "checkbox"});
  shown.addEventListener("change", () => set(name, {shown: shown.checked}));
  const parts = [make("label", {}, shown, label)];
  if (opacity !== null) {
    const slider = make("input", {type: "range", min: 0.1, max: 1, step: 0.05, "aria-label": `opacity of ${label}`});
    slider.addEventListener("input", () => set(name, {opacity: Number(slider.value)}));
    parts.push(slider);
  }
  const show = (layers) => {
    shown.checked = layers[name].shown;
    if (parts[1]) parts[1].value = layers[name].opacity;
  };
  show(state.layers);
  subscribe("layers", show);  // keys of the map switch, too
  return make("div", {className: "layer"}, ...parts);
}

export function startLayers() {
  const before = kept();
  change("layers", {...state.layers, ...Object.fromEntries(LAYERS.map(({name, shown = true, opacity}) => {
    const {shown: was, opacity: said} = before[name] ?? {};
    const opaque = opacity !== null && said >= 0.1 && said <= 1 ? said : opacity ?? 1;
    return [name, {shown: typeof was === "boolean" ? was : shown, opacity: opaque}];
  }))});
  subscribe("layers", keep);
  element("layers").replaceChildren(...LAYERS.map(row));
}

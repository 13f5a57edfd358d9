// Palettes: which there are, which one is shown, and what its colours mean.
import {change, state, subscribe} from "./state.js";
import {chip, element} from "./tables.js";

const MEANINGS = ["occupied", "free", "undecided", "unknown"];

const preferred = () => matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "ros";

function showLegend() {
  const legend = state.map?.legend?.[state.palette];
  if (!legend) return;
  element("palette").value = state.palette;
  const meanings = {};
  for (const meaning of MEANINGS.filter((name) => legend[name])) (meanings[legend[meaning]] ??= []).push(meaning);
  element("legend").replaceChildren(...Object.entries(meanings).map(([colour, all]) => chip(colour, all.join(", "))));
  element("map").style.setProperty("--ground", legend.unknown);
}

export function startPalettes() {
  const select = element("palette");
  state.palette ??= preferred();
  subscribe("map", ({palettes}) => {
    if (select.options.length !== palettes.length) select.replaceChildren(...palettes.map((name) => new Option(name)));
    showLegend();
  });
  subscribe("palette", showLegend);
  select.addEventListener("change", () => change("palette", select.value));
}

// Quality: its figures, and curves of how the map settles.
import {state, subscribe} from "./state.js";
import {chip, element, fill} from "./tables.js";
import {area, bits, duration, percent} from "./units.js";

const CURVES = [["known_m2", "known area", area, "#1c7ed6"], ["mean_entropy_bits", "mean entropy", bits, "#e8590c"]];
let looked = null;  // where the pointer is on the curves, 0 to 1

function show(quality) {
  const {series} = quality, {revision, stamp} = state.status, now = {...quality, revision, stamp};
  if (series.revision.length && series.revision.at(-1) < now.revision) {
    for (const [name, values] of Object.entries(series)) values.push(now[name]);
  }
  element("quality").hidden = !series.revision.length;
  element("truth").hidden = !quality.truth;
  fill("figures", [
    ["free", area(quality.free_m2)],
    ["occupied", area(quality.occupied_m2)],
    ["consistency of hits", percent(quality.consistency.hits)],
    ["consistency of free", percent(quality.consistency.free)],
  ]);
  const {log_loss, ...shares} = quality.truth ?? {};
  fill("agreement", !quality.truth ? [] : [
    ...Object.entries(shares).map(([name, share]) => [name, percent(share)]),
    ["log loss", log_loss?.toFixed(3) ?? "none"],
  ]);
  drawCurves();
}

function drawCurves() {
  const {series} = state.quality ?? {series: {revision: []}}, last = series.revision.length - 1;
  if (last < 0) return;
  const [start, end] = [series.stamp[0], series.stamp[last]];
  // Logs may have no times: then scans are counted.
  const x = end > start ? series.stamp.map((stamp) => (stamp - start) / 1e9) : series.revision;
  const at = (k) => (x[k] - x[0]) / (x[last] - x[0] || 1);
  const where = looked === null ? last : x.findLastIndex((_, k) => at(k) <= looked);
  element("since").textContent = `after ${end > start ? duration(x[where]) : `${x[where]} scans`}`;
  element("curves").replaceChildren(...CURVES.flatMap(([field, name, text, colour]) => {
    const values = series[field], most = Math.max(...values) || 1;
    const points = values.map((value, k) => `${100 * at(k)},${100 - 95 * value / most}`);
    const head = document.createElement("div"), value = document.createElement("span");
    head.className = "curve";
    value.append(text(values[where]));
    head.append(chip(colour, name), value);
    const box = document.createElement("div");
    box.innerHTML = `<svg viewBox="0 0 100 100" preserveAspectRatio="none" role="img" aria-label="${name}">
      <polygon points="0,100 ${points.join(" ")} ${100 * at(last)},100" fill="${colour}" opacity=".15"/>
      <polyline points="${points.join(" ")}" fill="none" stroke="${colour}" stroke-width="1.5"/>
      <path d="M${points[where]}V100" stroke="${colour}" opacity=".6"/>
      <path d="M${points[where]}h0" stroke="${colour}" stroke-width="6" stroke-linecap="round"/></svg>`;
    return [head, box];
  }));
}

export function startCurves() {
  subscribe("quality", show);
  element("curves").addEventListener("pointermove", (event) => {
    const box = element("curves").getBoundingClientRect();
    looked = Math.max(0, (event.clientX - box.left) / box.width);
    drawCurves();
  });
  element("curves").addEventListener("pointerleave", () => { looked = null; drawCurves(); });
}

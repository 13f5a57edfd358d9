// Quality: its figures, and curves of how the map settles.
import {make} from "./elements.js";
import {state, subscribe} from "./state.js";
import {element, fill} from "./tables.js";
import {area, bits, counted, duration, percent} from "./units.js";

const SVG = "http://www.w3.org/2000/svg";
const CURVES = [
  ["known_m2", "known area", area],
  ["mean_entropy_bits", "mean entropy", bits],
  ["hit", "beams that the map predicts", percent],  // null where none was judged
];
const STEP = 0.02;  // of an arrow key
let looked = null;  // which time is looked at, 0 to 1; null: the newest

function svg(tag, attributes, ...children) {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

function show(quality) {
  const {series} = quality, {revision, stamp} = state.status, now = {...quality, revision, stamp};
  if (series.revision.length && series.revision.at(-1) < now.revision) {
    for (const [name, values] of Object.entries(series)) values.push(now[name] ?? null);
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
    ...Object.entries(shares).map(([name, share]) => [name === "iou" ? "IoU" : name, percent(share)]),
    ["log loss", log_loss?.toFixed(3) ?? "none"],
  ]);
  drawCurves();
}

function drawCurves() {
  const series = state.quality?.series, last = series ? series.revision.length - 1 : -1;
  if (last < 0) return;
  const [start, end] = [series.stamp[0], series.stamp[last]];
  // Logs may have no times: then scans are counted.
  const x = end > start ? series.stamp.map((stamp) => (stamp - start) / 1e9) : series.revision;
  const at = (k) => (x[k] - x[0]) / (x[last] - x[0] || 1);
  const where = looked === null ? last : x.findLastIndex((_, k) => at(k) <= looked);
  element("since").textContent = `after ${end > start ? duration(x[where]) : counted(x[where], "scan")}`;
  const shown = CURVES.filter(([field]) => series[field]?.some((value) => value !== null));
  element("curves").replaceChildren(...shown.map(([field, name, words]) => spark(field, name, words, series[field], at, where)));
}

function spark(field, name, words, values, at, where) {
  const is = (value) => value !== null, most = Math.max(...values) || 1;
  const [first, last] = [values.findIndex(is), values.findLastIndex(is)];
  const there = values.findLastIndex((value, k) => is(value) && k <= where);
  const points = values.map((value, k) => is(value) && `${100 * at(k)},${100 - 92 * value / most}`), line = points.filter(Boolean).join(" ");
  return make("figure", {className: `spark ${field}`},
    make("figcaption", {}, make("span", {}, name), make("span", {}, words(values[there] ?? null))),
    svg("svg", {viewBox: "0 0 100 100", preserveAspectRatio: "none", role: "img",
                "aria-label": `${name}: ${words(values[first])} at first, ${words(values[last])} now`},
      svg("polygon", {points: `${100 * at(first)},100 ${line} ${100 * at(last)},100`}),
      svg("polyline", {points: line}),
      ...(there < 0 ? [] : [svg("path", {class: "where", d: `M${points[there]}V100`}), svg("path", {class: "point", d: `M${points[there]}h0`})])));
}

function look(where) {
  looked = where;
  drawCurves();
}

export function startCurves() {
  subscribe("quality", show);
  const curves = element("curves");
  curves.addEventListener("pointermove", (event) => {
    const box = curves.getBoundingClientRect();
    look(Math.max(0, (event.clientX - box.left) / box.width));
  });
  curves.addEventListener("keydown", (event) => {
    const step = {ArrowLeft: -STEP, ArrowRight: STEP}[event.key];
    if (!step) return;
    event.preventDefault();
    look(Math.min(1, Math.max(0, (looked ?? 1) + step)));
  });
  for (const left of ["pointerleave", "blur"]) curves.addEventListener(left, () => look(null));
}

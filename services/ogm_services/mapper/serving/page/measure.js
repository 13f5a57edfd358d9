// Measures along points that are clicked.
import {label, mark} from "./overlay.js";
import {change, state, subscribe} from "./state.js";

let points = [], pointer = null;  // [x, y] in metres

export const lengthOf = (way) =>
  way.slice(1).reduce((sum, [x, y], k) => sum + Math.hypot(x - way[k][0], y - way[k][1]), 0);

export const measured = () => lengthOf(points);
export const toggleMeasure = () => change("tool", state.tool === "measure" ? null : "measure");

export const measureLayer = {
  name: "measure",
  draw(pen, view) {
    if (state.tool !== "measure") return;
    const way = pointer && points.length ? [...points, pointer] : points;
    const places = way.map(([x, y]) => view.toCanvas(x, y)), ink = mark();
    Object.assign(pen, {strokeStyle: ink, fillStyle: ink, lineWidth: 2, lineJoin: "round"});
    pen.beginPath();
    places.forEach(([u, v], k) => k ? pen.lineTo(u, v) : pen.moveTo(u, v));
    pen.stroke();
    for (const [u, v] of places) pen.fillRect(u - 3, v - 3, 6, 6);
    if (way.length < 2) return;
    const last = lengthOf(way.slice(-2)), more = way.length > 2 ? ` (+${last.toFixed(2)})` : "";
    label(pen, `${lengthOf(way).toFixed(2)} m${more}`, places.at(-1), view.width, ink);
  },
};

export function startMeasure(view, redraw) {
  const placed = ({latlng: {lat: y, lng: x}}) => [x, y];
  subscribe("tool", () => { points = []; pointer = null; redraw(); });
  view.map.on("click", (event) => {
    if (state.tool !== "measure") return;
    points.push(placed(event));
    pointer = null;  // until it moves on: no piece of 0 m is begun
    redraw();
  });
  view.map.on("mousemove", (event) => {
    if (state.tool !== "measure") return;
    pointer = placed(event);
    redraw();
  });
}

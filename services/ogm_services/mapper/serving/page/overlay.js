// Robots on the map: an arrow where each is, and its name in a halo of the ground's colour.
import {colourOf, present} from "./robots.js";
import {state} from "./state.js";

const FONT = "600 12px system-ui, sans-serif", LINE = 12;

const colourFor = (meaning, otherwise) => state.map?.legend?.[state.palette]?.[meaning] ?? otherwise;
export const ground = () => colourFor("unknown", "#cdcdcd");
const free = () => colourFor("free", "#fefefe");

// Whether what is drawn there has to be light.
export function isDark(colour) {
  const [red, green, blue] = [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
  return 0.3 * red + 0.6 * green + 0.1 * blue < 110;
}

// The colour of a robot on the map, where it drives: on free cells.
export const inkOf = (name) => isDark(free()) ? colourOf(name).replace("40%", "66%") : colourOf(name);

export function outlined(pen, text, u, v, fillStyle, {size = "12px", halo = ground()} = {}) {
  Object.assign(pen, {font: FONT.replace("12px", size), lineWidth: 4, lineJoin: "round", strokeStyle: halo, fillStyle});
  pen.strokeText(text, u, v);
  pen.fillText(text, u, v);
}

// Where a text beside a point begins, on the side where there is room for it, and how long it is.
function beside(pen, text, u, width) {
  pen.font = FONT;
  const {width: length} = pen.measureText(text);
  return {from: u + 14 + length < width ? u + 10 : u - 10 - length, length};
}

// A text beside a point, `below` it or above.
export function label(pen, text, [u, v], width, colour, {below = false, halo = free()} = {}) {
  outlined(pen, text, beside(pen, text, u, width).from, v + (below ? 8 : -8), colour, {halo});
}

// The colour of lines and figures in metres, legible where the ground is neither light nor dark, too.
export const metreInk = () => isDark(ground()) ? "#a5d8ff" : "#0b3f70";

// The colour of what is drawn by hand.
export const mark = () => isDark(free()) ? "#ffd43b" : "#c2255c";

function arrow(pen, [u, v], theta, colour) {
  pen.save();
  pen.translate(u, v);
  pen.rotate(-theta);
  pen.beginPath();
  pen.moveTo(11, 0); pen.lineTo(-7, 7); pen.lineTo(-3, 0); pen.lineTo(-7, -7); pen.closePath();
  pen.strokeStyle = free(); pen.lineWidth = 2.5; pen.stroke();
  pen.fillStyle = colour; pen.fill();
  pen.restore();
}

const placed = () => present().filter((name) => state.robots[name]?.pose);

export const robotsLayer = {
  name: "robots",
  draw(pen, view) {
    for (const name of placed()) {
      const {pose: [x, y, theta], alive} = state.robots[name];
      pen.globalAlpha *= alive === false ? 0.45 : 1;
      arrow(pen, view.toCanvas(x, y), theta, inkOf(name));
      pen.globalAlpha /= alive === false ? 0.45 : 1;
    }
  },
};

export const namesLayer = {
  name: "names",
  draw(pen, view) {
    const taken = [];
    // Of names that would lie over each other one is legible, that of a followed robot first.
    for (const name of placed().sort((one, other) => (other === state.followed) - (one === state.followed))) {
      const [u, v] = view.toCanvas(...state.robots[name].pose), {from, length} = beside(pen, name, u, view.width);
      if (taken.some((it) => Math.abs(it.v - v) < LINE && from < it.from + it.length && it.from < from + length)) continue;
      taken.push({from, length, v});
      label(pen, name, [u, v], view.width, inkOf(name));
    }
  },
};

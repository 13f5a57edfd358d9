// Robots on the map: an arrow where each is, and its name in a halo of the ground's colour.
import {colourOf, present} from "./robots.js";
import {state} from "./state.js";

const FONT = "600 12px system-ui, sans-serif";

export const ground = () => state.map?.legend?.[state.palette]?.unknown ?? "#cdcdcd";

// Whether what is drawn there has to be light.
export function isDark(colour) {
  const [red, green, blue] = [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
  return 0.3 * red + 0.6 * green + 0.1 * blue < 110;
}

// The colour of a robot on the map's ground.
export const inkOf = (name) => isDark(ground()) ? colourOf(name).replace("40%", "66%") : colourOf(name);

export function outlined(pen, text, u, v, fillStyle) {
  Object.assign(pen, {font: FONT, lineWidth: 4, lineJoin: "round", strokeStyle: ground(), fillStyle});
  pen.strokeText(text, u, v);
  pen.fillText(text, u, v);
}

function arrow(pen, [u, v], theta, colour) {
  pen.save();
  pen.translate(u, v);
  pen.rotate(-theta);
  pen.beginPath();
  pen.moveTo(11, 0); pen.lineTo(-7, 7); pen.lineTo(-3, 0); pen.lineTo(-7, -7); pen.closePath();
  pen.strokeStyle = isDark(ground()) ? "#000" : "#fff"; pen.lineWidth = 2.5; pen.stroke();
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
    pen.font = FONT;
    for (const name of placed()) {
      const [u, v] = view.toCanvas(...state.robots[name].pose), {width} = pen.measureText(name);
      outlined(pen, name, u + 14 + width < view.width ? u + 10 : u - 10 - width, v - 8, inkOf(name));
    }
  },
};

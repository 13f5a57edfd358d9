// The scale bar.
import {ground, metreInk, outlined} from "./overlay.js";
import {metres, roundLength} from "./units.js";

const BAR = 120, MARGIN = 16;  // at most, CSS pixels

export const scaleLayer = {
  name: "scale",
  draw(pen, {height, metre}) {
    const length = roundLength(BAR / metre), u = MARGIN, v = height - MARGIN, ink = metreInk();
    pen.fillStyle = ground(); pen.fillRect(u - 1, v - 1, length * metre + 2, 5);
    pen.fillStyle = ink; pen.fillRect(u, v, length * metre, 3);
    outlined(pen, metres(length), u, v - 6, ink);
  },
};

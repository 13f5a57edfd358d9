// Lines each so many metres, with their coordinates at the edges; those through the origin are stronger.
import {metreInk, outlined} from "./overlay.js";
import {roundLength} from "./units.js";

const APART = 180;  // at most, CSS pixels

const text = (at, step) => at.toFixed(Math.max(0, -Math.floor(Math.log10(step))));

export const gridLayer = {
  name: "grid",
  draw(pen, view) {
    const step = roundLength(APART / view.metre), [x0, y1] = view.toWorld(0, 0);
    const [x1, y0] = view.toWorld(view.width, view.height), ink = metreInk(), {globalAlpha} = pen;
    const line = (at, from, to) => {
      pen.beginPath();
      pen.moveTo(...from); pen.lineTo(...to);
      Object.assign(pen, {strokeStyle: ink, lineWidth: 1, globalAlpha: globalAlpha * (at === 0 ? 0.6 : 0.22)});
      pen.stroke();
      pen.globalAlpha = globalAlpha;
    };
    for (let n = Math.ceil(x0 / step); n * step <= x1; n++) {
      const u = Math.round(view.toCanvas(n * step, 0)[0]) + 0.5;
      line(n, [u, 0], [u, view.height]);
      if (u > 110) outlined(pen, text(n * step, step), u + 3, view.height - 6, ink, {size: "11px"});
    }
    for (let n = Math.ceil(y0 / step); n * step <= y1; n++) {
      const v = Math.round(view.toCanvas(0, n * step)[1]) + 0.5, said = text(n * step, step);
      line(n, [0, v], [view.width, v]);
      if (v < view.height - 40) outlined(pen, said, view.width - 8 - pen.measureText(said).width, v - 4, ink, {size: "11px"});
    }
  },
};

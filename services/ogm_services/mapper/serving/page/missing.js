// Parts of a map that no mapper answers for at present, where the status tells of any: named, and greyed on the map.
import {outlined} from "./overlay.js";
import {state, subscribe} from "./state.js";
import {element, fill} from "./tables.js";
import {clock} from "./units.js";

const parts = () => state.status?.missing ?? [];
const since = (stamp) => stamp ? `since ${clock(stamp / 1e6)}` : "no answer";

// What is seen of a part, which may be open on any side: left, top, right, bottom in CSS pixels.
function rectangle([xmin, ymin, xmax, ymax], view) {
  const [left, bottom] = view.toCanvas(xmin ?? 0, ymin ?? 0), [right, top] = view.toCanvas(xmax ?? 0, ymax ?? 0);
  return [
    xmin === null ? 0 : Math.max(left, 0), ymax === null ? 0 : Math.max(top, 0),
    xmax === null ? view.width : Math.min(right, view.width), ymin === null ? view.height : Math.min(bottom, view.height)];
}

export const missingLayer = {
  name: "missing",
  draw(pen, view) {
    pen.fillStyle = "#868e96b3";
    for (const {share, bounds} of parts().filter((part) => part.bounds)) {
      const [left, top, right, bottom] = rectangle(bounds, view);
      if (right <= left || bottom <= top) continue;
      pen.fillRect(left, top, right - left, bottom - top);
      const text = `share ${share} does not answer`, middle = (left + right) / 2;
      outlined(pen, text, middle - pen.measureText(text).width / 2, (top + bottom) / 2, "#fff", {halo: "#343a40"});
    }
  },
};

// `redraw()` draws the map again.
export function startMissing(redraw) {
  subscribe("status", () => {
    redraw();
    element("missing").hidden = !parts().length;
    fill("parts", parts().map(({share, since: stamp}) => [`share ${share}`, since(stamp)]));
  });
}

// Parts of a map that no mapper answers for at present, where the status tells of any: named, and greyed on the map.
import {state, subscribe} from "./state.js";
import {element, fill} from "./tables.js";
import {clock} from "./units.js";

const parts = () => state.status?.missing ?? [];
const since = (stamp) => stamp ? `since ${clock(stamp / 1e6)}` : "no answer";

export const missingLayer = {
  name: "missing",
  draw(pen, view) {
    pen.fillStyle = "#868e96b3";
    for (const {bounds} of parts().filter((part) => part.bounds)) {
      const [left, bottom] = view.toCanvas(bounds[0], bounds[1]), [right, top] = view.toCanvas(bounds[2], bounds[3]);
      pen.fillRect(left, top, right - left, bottom - top);
    }
  },
};

export function startMissing() {
  subscribe("status", () => {
    element("missing").hidden = !parts().length;
    fill("parts", parts().map(({share, since: stamp}) => [`share ${share}`, since(stamp)]));
  });
}

// Below a robot's name on the map: what keeps its scans out of the map at this moment.
import {ground, isDark, outlined} from "./overlay.js";
import {state} from "./state.js";
import {wrongNow} from "./troubles.js";

export const troubleLayer = {
  name: "troubles",
  draw(pen, view) {
    const ink = isDark(ground()) ? "#ffa94d" : "#8a3b00";
    for (const [name, {pose}] of Object.entries(state.robots)) {
      const why = pose && wrongNow(name);
      if (!why) continue;
      const [u, v] = view.toCanvas(pose[0], pose[1]), text = `not in the map: ${why}`, {width} = pen.measureText(text);
      outlined(pen, text, u + 14 + width < view.width ? u + 10 : u - 10 - width, v + 8, ink);
    }
  },
};

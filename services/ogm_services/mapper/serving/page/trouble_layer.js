// Below a robot's name on the map: what keeps its scans out of the map at this moment.
import {ground, isDark, label} from "./overlay.js";
import {state} from "./state.js";
import {wrongNow} from "./troubles.js";

export const troubleLayer = {
  name: "troubles",
  draw(pen, view) {
    const ink = isDark(ground()) ? "#ffa94d" : "#8a3b00";
    for (const [name, {pose}] of Object.entries(state.robots)) {
      const why = pose && wrongNow(name);
      if (!why) continue;
      label(pen, `not in the map: ${why}`, view.toCanvas(...pose), view.width, ink, {below: true, halo: ground()});
    }
  },
};

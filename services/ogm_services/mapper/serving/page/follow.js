// Keeps a robot in the middle of the view.
import {present} from "./robots.js";
import {change, state, subscribe} from "./state.js";

// The next robot after the one that is followed; after the last one: none.
export function followNext() {
  const names = present().filter((name) => state.robots[name]?.pose);
  change("followed", names[names.indexOf(state.followed) + 1] ?? null);
}

export function startFollow(view) {
  const centre = () => {
    const pose = state.robots[state.followed]?.pose;
    if (pose) view.centreOn(pose[0], pose[1]);
  };
  subscribe("followed", (name) => {
    if (name !== null) view.touched = true;
    centre();
  });
  subscribe("robots", centre);
  view.map.on("dragstart", () => { if (state.followed !== null) change("followed", null); });
}

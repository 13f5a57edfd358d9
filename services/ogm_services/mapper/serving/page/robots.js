// Robots by name: which are there, and which colour each has, the same in the panel and on the map.
import {GONE_AFTER_S} from "./constants.js";
import {state} from "./state.js";

const SILENT_AFTER_S = 5;  // one that says nothing for so long is shown grey

const known = () => Object.keys({...state.status?.robots, ...state.robots}).sort();

export const isGone = ({alive, age_s, pose, sources}) =>
  !alive && (age_s === null ? !pose && !Object.keys(sources).length : age_s > GONE_AFTER_S);

export const isSilent = ({alive, age_s}) => !alive || age_s === null || age_s > SILENT_AFTER_S;

export const present = () => known().filter((name) => {
  const told = state.status?.robots[name];
  return !told || !isGone(told);
});

export const colour = (index) => `hsl(${(20 + 137.5 * index) % 360} 85% 40%)`;

// The same whoever leaves.
export const colourOf = (name) => colour(known().indexOf(name));

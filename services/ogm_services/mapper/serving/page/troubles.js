// What keeps scans of robots out of the map, of which robot and whether it goes on, and what helps.
import {Rates} from "./rates.js";
import {state, subscribe} from "./state.js";
import {DROPPED, HINT, LOST, ON_ROBOTS} from "./what_helps.js";

export const rates = new Rates();
const LOST_NAME = "lost", ON_ROBOTS_NAME = "beams on robots";

// All counts of a status that grow, by name.
function counts({scans, robots}) {
  const all = {integrated: scans.integrated};
  for (const [robot, {sources}] of Object.entries(robots)) {
    for (const [sensor, {integrated, dropped, lost = 0}] of Object.entries(sources)) {
      all[`${robot}/${sensor}`] = integrated;
      all[`${robot}/${sensor} ${LOST_NAME}`] = lost;
      for (const [reason, count] of Object.entries(dropped)) all[`${robot}/${sensor} ${reason}`] = count;
    }
  }
  return all;
}

// Of a robot: [{sensor, what, count, rate, help}]; hints have no count, and a rate only what is counted as scans.
export function troublesOf(name) {
  const sources = Object.entries(state.status?.robots[name]?.sources ?? {});
  return sources.flatMap(([sensor, {dropped, hints, lost = 0, beams_on_robots: beams = 0}]) => {
    const rate = (what) => rates.of(`${name}/${sensor} ${what}`);
    return [
      ...Object.entries(dropped).map(([what, count]) => ({sensor, what, count, rate: rate(what), help: DROPPED[what] ?? ""})),
      ...(lost ? [{sensor, what: LOST_NAME, count: lost, rate: rate(LOST_NAME), help: LOST}] : []),
      ...(beams ? [{sensor, what: ON_ROBOTS_NAME, count: beams, rate: null, help: ON_ROBOTS}] : []),
      ...hints.map((hint) => ({sensor, what: `hint ${hint}`, count: null, rate: null, help: HINT})),
    ];
  });
}

// The scans of a robot that are not in the map.
export const missed = (troubles) => troubles.reduce(
  (sum, {what, count}) => what === ON_ROBOTS_NAME ? sum : sum + (count ?? 0), 0);

// Why scans of a robot are kept out at this moment, "" if none are.
export const wrongNow = (name) =>
  [...new Set(troublesOf(name).filter(({rate}) => rate > 0).map(({what}) => what))].join(", ");

// How many scans of a robot a second get into the map; null while it is not known.
export function rateOf(name) {
  const all = Object.keys(state.status?.robots[name]?.sources ?? {}).map((sensor) => rates.of(`${name}/${sensor}`));
  return all.length && all.every((rate) => rate !== null) ? all.reduce((sum, rate) => sum + rate, 0) : null;
}

// Whose counts they are: those of a part that is missing are not among a gateway's.
const counted = ({run, missing = []}) => [run, ...missing.map(({share}) => share)].join(" ");

export function startTroubles() {
  subscribe("status", (status) => rates.look(counted(status), performance.now() / 1000, counts(status)));
}

// The panel beside the map: status, robots, and what keeps scans out of the map.
import {colourOf, present} from "./robots.js";
import {state, subscribe} from "./state.js";
import {chip, element, fill} from "./tables.js";
import {duration} from "./units.js";

const RATE_MS = 2000;  // a rate is taken over at least so long
let counted = null;   // {time, scans, run} of the last time that the rate was taken
let rate = null;

function takeRate({run, scans: {integrated}}) {
  const now = performance.now();
  if (counted?.run !== run) counted = rate = null;  // another process, which counts from 0
  if (counted && now - counted.time <= RATE_MS) return;
  if (counted) rate = `${((integrated - counted.scans) / (now - counted.time) * 1000).toFixed(1)} /s`;
  counted = {time: now, scans: integrated, run};
}

const some = (counts, prefix, except = []) => Object.entries(counts)
  .filter(([what, count]) => !except.includes(what) && count > 0)
  .map(([what, count]) => [`${prefix}${what}`, count]);

function showFacts(status) {
  const {scans, map_info: info} = status;
  fill("facts", [
    ["revision", status.revision],
    ["scans received", scans.received],
    ["scans integrated", scans.integrated],
    ["scans pending", scans.pending],
    ...some(scans.dropped, "scans dropped: "),
    ...(scans.lost ? [["scans lost", scans.lost]] : []),
    ...some(status.poses, "poses ", ["received", "replayed"]),
    ...(rate ? [["integrating", rate]] : []),
    ["size", `${(info.width * info.resolution).toFixed(1)} × ${(info.height * info.resolution).toFixed(1)} m`],
    ["resolution", `${info.resolution} m`],
    ["known cells", info.known_cells.toLocaleString("en")],
    ["memory", `${(info.bytes / 1e6).toFixed(1)} MB`],
    ["uptime", `${status.uptime_s.toFixed(0)} s`],
  ]);
}

function showRobots({robots}, names) {
  fill("robots", names.map((name) => {
    const {pose, alive, age_s, sources} = robots[name];
    const integrated = Object.values(sources).reduce((sum, source) => sum + source.integrated, 0);
    return [
      chip(colourOf(name), name), pose ? `${pose[0].toFixed(1)}, ${pose[1].toFixed(1)}` : "none",
      alive ? "yes" : "no", age_s === null ? "never" : `${duration(age_s)} ago`, integrated,
    ];
  }), names.length ? ["name", "x, y (m)", "alive", "heard", "scans"] : ["none yet"]);
}

function showReasons({robots}, names) {
  const wrong = names.flatMap((name) => Object.entries(robots[name].sources).flatMap(
    ([sensor, {dropped, hints, lost}]) => [
      ...Object.entries(dropped).map(([reason, count]) => [`${name}/${sensor}: ${reason}`, count]),
      ...(lost ? [[`${name}/${sensor}: lost`, lost]] : []),
      ...hints.map((hint) => [`${name}/${sensor}: hint ${hint}`, "see the log"]),
    ]));
  element("wrong").hidden = !wrong.length;
  fill("reasons", wrong);
}

export function startPanel() {
  subscribe("status", (status) => {
    takeRate(status);
    element("name").textContent = status.map;
    const names = present().filter((name) => status.robots[name]);
    showFacts(status);
    showRobots(status, names);
    showReasons(status, names);
  });
  subscribe("connection", ({kind, text}) => {
    element("state").textContent = text;
    element("state").className = kind === "live" ? "" : kind;
  });
}

// Where robots have been since the page was opened, in this life of the map.
import {inkOf} from "./overlay.js";
import {state, subscribe} from "./state.js";

const MOST = 2000;  // points of a robot
const STEP = 0.03;  // metres between two of them
const JUMP = 1.0, SPEED = 5.0;  // m and m/s: who is farther away than both was put there

const trails = new Map();  // by robot: [{x, y, stamp, jump}]

export const forgetTrails = () => trails.clear();
export const trailOf = (name) => trails.get(name) ?? [];

function note(robots) {
  for (const [name, {pose, stamp}] of Object.entries(robots)) {
    if (!pose) continue;
    const [x, y] = pose, trail = trails.get(name) ?? [], last = trail.at(-1);
    const far = last ? Math.hypot(x - last.x, y - last.y) : Infinity;
    if (far < STEP) continue;
    const seconds = last ? Math.abs(Number(stamp) - last.stamp) / 1e9 : 0;
    trail.push({x, y, stamp: Number(stamp), jump: !last || far > Math.max(JUMP, SPEED * seconds)});
    if (trail.length > MOST) trail.shift();
    trails.set(name, trail);
  }
}

export const trailsLayer = {
  name: "trails",
  draw(pen, view) {
    Object.assign(pen, {lineWidth: 1.5, lineJoin: "round", lineCap: "round"});
    pen.globalAlpha *= 0.7;
    for (const [name, trail] of trails) {
      pen.beginPath();
      for (const {x, y, jump} of trail) {
        const [u, v] = view.toCanvas(x, y);
        if (jump) pen.moveTo(u, v);
        else pen.lineTo(u, v);
      }
      const now = state.robots[name]?.pose, last = trail.at(-1);
      if (now && last && Math.hypot(now[0] - last.x, now[1] - last.y) < JUMP) pen.lineTo(...view.toCanvas(...now));
      pen.strokeStyle = inkOf(name);
      pen.stroke();
    }
  },
};

export const startTrails = () => subscribe("robots", note);

// What the page knows of the mapper and how it shows it; whoever shows a part of it subscribes to that part.

export const state = {
  connection: {kind: "wait", text: "connecting", by: null},  // kind: live, wait or bad; by: push or polling
  map: null,      // name, epoch, run, revision, resolution, anchor, extent, palettes, legend: of tiles.json
  status: null,   // of /status
  quality: null,  // of /quality
  robots: {},     // by name: pose [x, y, theta] or null, stamp (ns), alive
  scans: {},      // by robot/sensor, the last one: stamp, pose of the sensor, angles, range_max, ranges
  palette: null,
  layers: {grid: {shown: false}},  // by name of a canvas layer: {shown, opacity}; others are shown
  access: null,   // of /login: whether a change wants the token, and which changes the mapper can make
  followed: null,  // the robot that the view follows
  tool: null,     // what clicks on the map are for: measure, ...; null: a point
};

const subscribers = new Map();

// `show(value)` is called with each new value of a part.
export function subscribe(part, show) {
  if (!(part in state)) throw new Error(`the state has no ${part}`);
  subscribers.set(part, [...(subscribers.get(part) ?? []), show]);
}

export function change(part, value) {
  if (!(part in state)) throw new Error(`the state has no ${part}`);
  state[part] = value;
  for (const show of subscribers.get(part) ?? []) show(value);
}

// The last scan of each sensor: the area that its beams passed, and where they ended.
import {inkOf} from "./overlay.js";
import {present} from "./robots.js";
import {state} from "./state.js";

// Ends of the beams on the canvas; those that met nothing end at the range's limit.
function endsOf({pose: [x, y, theta], angle_min, angle_increment, range_max, ranges}, view) {
  return Array.from(ranges, (range, k) => {
    const hit = range > 0 && range < range_max, length = hit ? range : range === Infinity ? range_max : 0;
    const angle = theta + angle_min + k * angle_increment;
    return {at: view.toCanvas(x + length * Math.cos(angle), y + length * Math.sin(angle)), hit};
  });
}

export const scansLayer = {
  name: "scans",
  draw(pen, view) {
    const {globalAlpha} = pen, there = new Set(present());
    for (const [source, scan] of Object.entries(state.scans)) {
      const [robot] = source.split("/");
      if (!scan.pose || !scan.ranges.length || !there.has(robot)) continue;
      const ends = endsOf(scan, view), colour = inkOf(robot);
      pen.fillStyle = colour;
      pen.beginPath();
      pen.moveTo(...view.toCanvas(scan.pose[0], scan.pose[1]));
      for (const {at: [u, v]} of ends) pen.lineTo(u, v);
      pen.closePath();
      pen.globalAlpha = 0.1 * globalAlpha;
      pen.fill();
      pen.globalAlpha = globalAlpha;
      for (const {at: [u, v], hit} of ends) if (hit) pen.fillRect(u - 1, v - 1, 2, 2);
    }
  },
};

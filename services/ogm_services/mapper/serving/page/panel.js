// The panel beside the map, on a phone a sheet over its lower part: the mapper's status.
import {say} from "./elements.js";
import {showRobots} from "./robot_cards.js";
import {state, subscribe} from "./state.js";
import {element, fill} from "./tables.js";
import {rates} from "./troubles.js";
import {duration, metresBy, perSecond, whole} from "./units.js";

const PHONE = matchMedia("(max-width: 46rem)");

const some = (counts, prefix, except = []) => Object.entries(counts)
  .filter(([what, count]) => !except.includes(what) && count > 0)
  .map(([what, count]) => [`${prefix}${what}`, whole(count)]);

function showFacts(status) {
  const {scans, map_info: info, store} = status;
  fill("facts", [
    ["revision", whole(status.revision)],
    ["scans received", whole(scans.received)],
    ["scans integrated", whole(scans.integrated)],
    ["scans pending", whole(scans.pending)],
    ...some(scans.dropped, "scans dropped: "),
    ...(scans.lost ? [["scans lost", whole(scans.lost)]] : []),
    ...some(status.poses, "poses ", ["received", "replayed"]),
    ["resolution", `${info.resolution} m`],
    ["known cells", whole(info.known_cells)],
    ["memory", `${(info.bytes / 1e6).toFixed(1)} MB`],
    ...(store ? [["stored", store.revision === null ? "nothing yet" : `revision ${whole(store.revision)}`]] : []),
    ["up", duration(status.uptime_s)],
  ]);
  say(element("size"), info.width ? metresBy(info.width * info.resolution, info.height * info.resolution) : "empty");
}

function showNow({revision, scans}) {
  const rate = rates.of("integrated");
  say(element("now"), [
    `revision ${whole(revision)}`,
    ...(rate === null ? [] : [`${perSecond(rate, "scans")}`]),
    ...(scans.pending ? [`${whole(scans.pending)} pending`] : []),
    ...(scans.lost ? [`${whole(scans.lost)} lost`] : []),
  ].join(" · "));
}

function open(wanted) {
  element("panel").classList.toggle("closed", !wanted);
  element("grip").setAttribute("aria-expanded", String(wanted));
}

export function startPanel() {
  subscribe("status", (status) => {
    say(element("name"), status.map);
    showFacts(status);
    showNow(status);
    showRobots();
  });
  subscribe("followed", showRobots);
  subscribe("connection", ({kind, text}) => {
    say(element("state"), text);
    element("state").className = kind === "live" ? "" : kind;
    element("empty").hidden = kind === "bad" || !state.map || Boolean(state.map.extent);
  });
  element("grip").addEventListener("click", () => open(element("panel").classList.contains("closed")));
  open(!PHONE.matches);
  PHONE.addEventListener("change", ({matches}) => open(!matches));  // it was turned
  subscribe("tool", (tool) => { if (tool && PHONE.matches) open(false); });  // it wants the map
}

// What keeps the page up to date: /tiles.json tells of the map, /status of robots, /quality how good the map is.
import {ask, askJson} from "./ask.js";
import {change, state} from "./state.js";

const PERIOD_MS = 500, MAP_PERIOD_MS = 1000;
let etag = null, askedMap = -Infinity, askedQuality = -Infinity;

async function refreshMap() {
  if (performance.now() - askedMap < MAP_PERIOD_MS) return;
  const reply = await ask("tiles.json", {headers: etag ? {"If-None-Match": etag} : {}});
  askedMap = performance.now();
  if (reply.status === 304) return;
  if (!reply.ok) throw new Error(`tiles.json: ${reply.status}`);
  const {name, ogm} = await reply.json();
  etag = reply.headers.get("ETag");
  change("map", {name, ...ogm});
}

async function refreshStatus() {
  const status = await askJson("status");
  change("status", status);
  change("robots", Object.fromEntries(Object.entries(status.robots).map(
    ([name, {pose, alive, stamp}]) => [name, {pose, alive, stamp}])));
}

async function refreshQuality() {
  if (performance.now() - askedQuality < 2 * PERIOD_MS) return;
  askedQuality = performance.now();
  change("quality", await askJson("quality"));
}

async function refresh() {
  try {
    await refreshStatus();
    await refreshMap();
    await refreshQuality();
    const live = Boolean(state.map.extent);
    change("connection", {kind: live ? "live" : "wait", text: live ? "live" : "waiting for the first scan", by: "polling"});
  } catch (error) {
    change("connection", {kind: "bad", text: `no answer from the mapper (${error.message})`, by: null});
  }
  setTimeout(refresh, PERIOD_MS);
}

export const startLink = () => refresh();

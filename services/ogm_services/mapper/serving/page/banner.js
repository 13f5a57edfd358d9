// The banner: what whoever looks at the map has to know before he trusts it; and short notices, which go by themselves.
import {element} from "./tables.js";
import {say} from "./elements.js";
import {change, state, subscribe} from "./state.js";
import {clock} from "./units.js";

const STALE_MS = 5000;  // so long nothing may come from a mapper that is there
const NOTICE_MS = 8000;
let heard = Date.now();  // when something came last
let before = null;  // the map that was told of last
let notice = 0;  // a timer

const isStale = () => Date.now() - heard > STALE_MS;

// A mapper that hangs closes no connection: it is given up before its answers are.
function watch() {
  if (isStale() && state.connection.kind === "live") change("connection", {kind: "bad", text: "no answer from the mapper", by: null});
  else show();
}

// What is wrong, [kind, text]; the text does not change while it lasts, lest it is read out again and again.
function trouble() {
  const {connection, status} = state;
  if (connection.kind === "bad" || isStale()) {
    if (!before) return ["bad", "No answer from the mapper yet. It is asked again and again."];
    return ["bad", `Nothing from the mapper since ${clock(heard)}: what you see is from then. It goes on by itself.`];
  }
  if (status?.store?.failing) return ["warn", `The map is not stored at present: ${status.store.failing}`];
  if (status?.missing?.length) {
    const shares = status.missing.map(({share}) => share).join(", ");
    return ["warn", `A part of the map is missing (grey): share ${shares} does not answer. What is shown there is from before.`];
  }
  return [null, ""];
}

function show() {
  const [kind, text] = trouble(), banner = element("banner");
  if (kind) banner.dataset.kind = kind;
  banner.hidden = !kind;
  say(banner, text);
  // What lies at the top of the map makes room for it.
  element("view").style.setProperty("--banner", `${banner.offsetHeight}px`);
}

// Say something in passing.
export function tell(text) {
  const place = element("notice");
  clearTimeout(notice);
  say(place, text);
  place.hidden = !text;
  if (text) notice = setTimeout(() => tell(""), NOTICE_MS);
}

function noteChange(told) {
  if (before && before.epoch !== told.epoch) tell("Another map: it was emptied, or one that was saved is shown.");
  else if (before && before.run !== told.run) tell("The mapper was started again and goes on with its map.");
  before = told;
}

export function startBanner() {
  const hear = () => { heard = Date.now(); show(); };
  for (const part of ["status", "map", "robots"]) subscribe(part, hear);
  subscribe("map", noteChange);
  subscribe("connection", show);
  // A page that nobody sees asks for nothing, and has missed nothing.
  document.addEventListener("visibilitychange", hear);
  setInterval(() => { if (!document.hidden) watch(); }, 1000);
}

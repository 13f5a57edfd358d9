// What is made of the messages that the mapper pushes: tiles, robots, and scans, as soon as they change.
import {Push} from "./push.js";
import {change, state, subscribe} from "./state.js";
import {placesOf} from "./view.js";

const RATE = 10;  // updates a second
const AWAIT_MS = 3000;

export class Live {
  // `tiles()` are those of the page, once there are any; `changed(open)` is called when pushing begins or ends.
  constructor(tiles, changed) {
    this.tiles = tiles;
    this.changed = changed;
    this.open = false;  // whether the mapper pushes
    this.wanted = null;  // the rectangle of tiles that is shown
    this.told = null;  // the one that the mapper knows
    this.seen = null;  // what was told last, and the revision up to which all of it has been heard
    this.push = new Push((message) => this.heard(message), () => this.closed());
    // An update does not say of which palette it is, but a connection has only one.
    subscribe("palette", () => { if (this.open) { this.push.stop(); this.push.start(); } });
  }

  // Tell the mapper which tiles are shown: of others it says nothing.
  show(rectangle) {
    this.wanted = rectangle;
    const tiles = this.tiles();
    if (!this.open || !tiles || this.told === rectangle || (this.told && tiles.awaiting)) return;
    const {z, x0, y0, x1, y1} = rectangle, shown = {z, tiles: [x0, y0, x1, y1], palette: state.palette};
    const {epoch, run, revision} = state.map, known = JSON.stringify([epoch, run, shown]);
    // Another connection goes on where the one before has ended.
    const since = !this.told && this.seen?.known === known ? {since: this.seen.revision} : {};
    this.push.say({type: "view", ...shown, rate: RATE, scans: true, ...since});
    if (since.since) tiles.awaiting = false;
    this.told = rectangle;
    this.seen = {known, revision};
    tiles.cover(placesOf(rectangle), since.since);
  }

  // All tiles of a first view come by themselves; the mapper is told of another one when they are there.
  awaitAll() {
    const tiles = this.tiles();
    if (!tiles) return;
    tiles.awaiting = true;
    clearTimeout(this.patience);
    this.patience = setTimeout(() => this.goOn(), AWAIT_MS);
  }

  goOn() {
    clearTimeout(this.patience);
    this.tiles().awaiting = false;
    if (this.wanted) this.show(this.wanted);
    this.tiles().refresh();
  }

  heard(message) {
    if (message.type === "hello") this.begin(message);
    else if (message.type === "update") this.update(message);
  }

  begin({map: name, epoch, run, revision, resolution, anchor, extent}) {
    this.open = true;
    this.told = null;
    this.awaitAll();
    change("map", {...state.map, name, epoch, run, revision, resolution, anchor, extent});
    if (this.wanted) this.show(this.wanted);
    this.changed(true);
  }

  update({epoch, run, revision, tiles: pushed, more, robots, scans = {}}) {
    const tiles = this.tiles(), {map} = state;
    if (map.epoch !== epoch || map.run !== run) {
      // It begins empty; all that is shown of it comes next.
      this.awaitAll();
      this.seen = null;
      change("map", {...map, epoch, run, revision, extent: null});
    } else {
      for (const [z, x, y, r, png] of pushed) tiles.put([z, x, y], r, png, {pushed: true});
      if (!more) this.complete(revision);
    }
    change("scans", Object.fromEntries(Object.entries(scans).map(([source, scan]) => [source, decoded(scan)])));
    change("robots", robots);
  }

  // All has been heard up to a revision.
  complete(revision) {
    state.map.revision = revision;
    if (this.seen) this.seen.revision = revision;
    if (!this.tiles().awaiting) return;
    this.tiles().complete();
    this.goOn();
  }

  closed() {
    clearTimeout(this.patience);
    const tiles = this.tiles(), was = this.open;
    this.open = false;
    this.told = null;
    if (tiles) {
      tiles.cover([]);
      tiles.awaiting = false;
      tiles.refresh();
    }
    change("scans", {});
    if (was) this.changed(false);
  }
}

// Ranges as numbers: where their bytes begin in a message is no place for numbers.
const decoded = (scan) => ({...scan, ranges: new Float32Array(scan.ranges.slice().buffer)});

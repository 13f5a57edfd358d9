// The tiles that the page holds: pictures of 256 x 256 pixels, each with the revision that it shows.
//
// One that the mapper pushes changes of is live; others are asked for again once the map has another revision.
import {ask} from "./ask.js";
import {state} from "./state.js";

const AT_ONCE = 5;  // requests; a browser opens six connections to a server
const HELD = 200;  // at least; 256 KB each
const NEVER = -1;
const keyOf = (z, x, y) => `${z}/${x}/${y}`;

export class Tiles {
  // `changed()` is called when another picture is there to be drawn.
  constructor(changed) {
    this.changed = changed;
    this.held = new Map();  // by key: {r, tag, at, live, bitmap, drawn, png}
    this.wanted = [];  // places; those in the middle first
    this.covered = new Set();  // keys of the places that changes are pushed of
    this.awaiting = false;  // whether all of those come by themselves
    this.asking = new Map();
    this.draws = 0;
    this.life = 0;  // answers to what was asked in an earlier one are of no use
  }

  // All that is held belongs to another map, or another palette.
  forget() {
    this.life += 1;
    for (const {bitmap} of this.held.values()) bitmap?.close();
    this.held.clear();
    this.asking.clear();
    this.changed();
  }

  // Revisions count anew in another process: pictures stay until it has been asked for all of them.
  forgetRevisions() {
    for (const tile of this.held.values()) Object.assign(tile, {r: NEVER, at: NEVER, live: false});
  }

  want(places) {
    this.wanted = places;
    this.refresh();
  }

  // From now on changes are pushed of the tiles at these places, those since a revision, and of others no longer.
  cover(places, since = Infinity) {
    this.covered = new Set(places.map((place) => keyOf(...place)));
    for (const [key, tile] of this.held) {
      const covered = this.covered.has(key);
      if (tile.live && !covered) Object.assign(tile, {live: false, at: state.map.revision});
      else if (covered && tile.at >= since) tile.live = true;
    }
  }

  // All tiles of the places that are covered have been pushed; nothing is known of those that have not.
  complete() {
    this.awaiting = false;
    for (const key of this.covered) {
      const tile = this.held.get(key) ?? {r: 0, tag: null, at: NEVER, bitmap: null, drawn: this.draws, png: null};
      tile.live = true;
      this.held.set(key, tile);
    }
  }

  // Ask for those that are wanted and may have changed.
  refresh() {
    if (this.awaiting) return;
    for (const place of this.wanted) {
      if (this.asking.size >= AT_ONCE) return;
      const key = keyOf(...place), tile = this.held.get(key);
      if (!this.asking.has(key) && !tile?.live && !(tile?.at >= state.map.revision)) this.fetch(key, place);
    }
  }

  async fetch(key, place) {
    const {life} = this, at = state.map.revision, tag = this.held.get(key)?.tag, asked = {};
    this.asking.set(key, asked);
    let told = false;
    try {
      const headers = tag ? {"If-None-Match": tag} : {};
      const reply = await ask(`tiles/${key}.png?palette=${state.palette}`, {headers});
      const png = await reply.arrayBuffer(), said = reply.headers.get("OGM-Revision"), r = Number(said ?? 0);
      // Of another map it comes again, with the news of that.
      if (life !== this.life || reply.headers.get("OGM-Epoch") !== state.map.epoch) return;
      if (reply.ok) this.put(place, r, said === null ? null : png, {tag: reply.headers.get("ETag")});
      const tile = this.held.get(key);
      if (!tile || !(reply.ok || reply.status === 304)) return;
      Object.assign(tile, {r: Math.max(tile.r, r), at: Math.max(tile.at, at), live: this.covered.has(key)});
      told = true;
    } catch {
      // The link says when the mapper is gone, and asks again when it is back.
    } finally {
      if (this.asking.get(key) === asked) this.asking.delete(key);
      if (told) this.refresh();
    }
  }

  // A tile as it is since revision `r`, unless a newer one is held; no bytes: nothing is known there.
  async put([z, x, y], r, png, {tag = null, pushed = false} = {}) {
    const key = keyOf(z, x, y), before = this.held.get(key), {life} = this;
    if (before && before.r >= r) return;
    const tile = {at: NEVER, live: false, bitmap: null, drawn: this.draws, ...before, r, tag, png};
    tile.live ||= pushed && this.covered.has(key);
    this.held.set(key, tile);
    const bitmap = png && await createImageBitmap(new Blob([png], {type: "image/png"}));
    if (life !== this.life || this.held.get(key) !== tile) { bitmap?.close(); return; }
    tile.bitmap?.close();
    tile.bitmap = bitmap;
    this.letGo();
    this.changed();
  }

  // The picture to be drawn at a place; undefined: none is held, null: nothing is known there.
  picture(z, x, y) {
    const tile = this.held.get(keyOf(z, x, y));
    if (tile) tile.drawn = this.draws;
    return tile?.bitmap;
  }

  letGo() {
    const most = Math.max(HELD, 2 * this.wanted.length);
    if (this.held.size <= most) return;
    const oldest = [...this.held].sort(([, one], [, other]) => one.drawn - other.drawn);
    for (const [key, tile] of oldest.slice(0, this.held.size - most)) {
      tile.bitmap?.close();
      this.held.delete(key);
    }
  }
}

// The tiles that the page holds: pictures of 256 x 256 pixels, each with the revision that it shows.
import {ask} from "./ask.js";
import {state} from "./state.js";

const AT_ONCE = 5;  // requests; a browser opens six connections to a server
const HELD = 200;  // at least; 256 KB each
const keyOf = (z, x, y) => `${z}/${x}/${y}`;

export class Tiles {
  // `changed()` is called when another picture is there to be drawn.
  constructor(changed) {
    this.changed = changed;
    this.held = new Map();  // by key: {z, x, y, r, tag, at, bitmap, drawn, png}
    this.wanted = [];  // of these, those that may have changed are asked for, the first ones first
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
    for (const tile of this.held.values()) tile.r = tile.at = -1;
    this.refresh();
  }

  want(places) {
    this.wanted = places;
    this.refresh();
  }

  // Ask for those that are wanted and not known to be as the map is now.
  refresh() {
    for (const place of this.wanted) {
      if (this.asking.size >= AT_ONCE) return;
      const key = keyOf(...place), tile = this.held.get(key);
      if (!this.asking.has(key) && !(tile && tile.at >= state.map.revision)) this.fetch(key, place);
    }
  }

  async fetch(key, [z, x, y]) {
    const {life} = this, at = state.map.revision, tile = this.held.get(key);
    const asked = {};
    this.asking.set(key, asked);
    try {
      const headers = tile?.tag ? {"If-None-Match": tile.tag} : {};
      const reply = await ask(`tiles/${key}.png?palette=${state.palette}`, {headers});
      const body = await reply.arrayBuffer(), png = reply.ok ? body : null;
      if (life !== this.life) return;
      const epoch = reply.headers.get("OGM-Epoch"), said = reply.headers.get("OGM-Revision");
      if (epoch !== state.map.epoch) return;  // it comes again with the new map
      const r = Number(said ?? 0);
      if (png) this.put([z, x, y], r, said === null ? null : png, reply.headers.get("ETag"));
      const now = this.held.get(key);
      if (!now || !(png || reply.status === 304)) return;
      now.r = Math.max(now.r, r);
      now.at = Math.max(now.at, at);
    } catch {
      // The link says when the mapper is gone, and asks again when it is back.
    } finally {
      if (this.asking.get(key) === asked) this.asking.delete(key);
      if (life === this.life && this.held.get(key)?.at >= at) this.refresh();
    }
  }

  // A tile as it is since revision `r`, unless a newer one is held; no bytes: nothing is known there.
  async put([z, x, y], r, png, tag = null) {
    const key = keyOf(z, x, y), before = this.held.get(key), {life} = this;
    if (before && before.r >= r) return;
    const tile = {at: -1, bitmap: null, drawn: this.draws, ...before, z, x, y, r, tag, png};
    this.held.set(key, tile);
    const bitmap = png && await createImageBitmap(new Blob([png], {type: "image/png"}));
    if (life !== this.life || this.held.get(key) !== tile) { bitmap?.close(); return; }
    before?.bitmap?.close();
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

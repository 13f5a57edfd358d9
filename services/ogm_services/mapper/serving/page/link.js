// Keeps the page up to date: what the mapper pushes, and what it is asked for each second, or twice without that.
import {ask, askJson} from "./ask.js";
import {Live} from "./live.js";
import {change, state} from "./state.js";

const PERIOD_MS = 1000;

export class Link {
  // `tiles()`: as of Live.
  constructor(tiles) {
    this.etag = null;  // of /tiles.json
    this.timer = 0;
    this.turn = 0;
    this.live = new Live(tiles, (open) => { if (!open) this.soon(0); });
  }

  start() {
    // A hidden tab asks for nothing.
    document.addEventListener("visibilitychange", () => document.hidden ? this.pause() : this.resume());
    if (!document.hidden) this.resume();
  }

  resume() {
    if (state.map) this.live.push.start();
    this.soon(0);
  }

  pause() {
    this.turn += 1;
    this.live.push.stop();
    clearTimeout(this.timer);  // which the end of pushing may have set
  }

  soon(delay) {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.refresh(), delay);
  }

  async refresh() {
    const turn = ++this.turn;
    let said;
    try {
      await Promise.all([this.refreshMap(turn), this.refreshStatus(turn)]);
      const quality = await askJson("quality");
      if (turn !== this.turn) return;
      change("quality", quality);
      said = state.map.extent ? {kind: "live", text: "live"} : {kind: "wait", text: "waiting for the first scan"};
    } catch (error) {
      // Browsers have words of their own for what does not arrive: they help nobody.
      const refused = error instanceof TypeError || error instanceof DOMException ? "" : ` (${error.message})`;
      said = {kind: "bad", text: `no answer from the mapper${refused}`};
    }
    if (turn !== this.turn) return;  // another one has begun
    const by = said.kind === "bad" ? null : this.live.open ? "push" : "polling";
    change("connection", {...said, by});
    this.soon(this.live.open ? PERIOD_MS : PERIOD_MS / 2);
  }

  async refreshMap(turn) {
    const reply = await ask("tiles.json", {headers: this.etag ? {"If-None-Match": this.etag} : {}});
    const text = await reply.text();
    if (turn !== this.turn || reply.status === 304) return;
    if (!reply.ok) throw new Error(`tiles.json: ${reply.status}`);
    const {name, ogm} = JSON.parse(text), {map} = state;
    // What has been pushed of the map is of another revision than what was asked for.
    const {epoch, run, revision} = this.live.open ? map : ogm;
    if (epoch !== ogm.epoch || run !== ogm.run) return;
    this.etag = reply.headers.get("ETag");
    change("map", {name, ...ogm, revision});
    if (!map) this.live.push.start();
  }

  async refreshStatus(turn) {
    const status = await askJson("status");
    if (turn !== this.turn) return;
    change("status", status);
    if (this.live.told) return;
    change("robots", Object.fromEntries(Object.entries(status.robots).map(
      ([name, {pose, alive, stamp}]) => [name, {pose, alive, stamp}])));
  }
}

// The WebSocket by which the mapper pushes what has changed: it is opened again and again while it cannot be had.
import {pack, unpack} from "./msgpack.js";

const FIRST_MS = 500, LAST_MS = 5000;  // between two tries
const SILENT_MS = 5000;  // the mapper says something each second

export class Push {
  // `heard(message)` is called with each message, `closed()` when no more will come, till the next one.
  constructor(heard, closed) {
    this.heard = heard;
    this.closed = closed;
    this.socket = null;
    this.timer = this.watch = 0;
    this.pause = FIRST_MS;
  }

  start() {
    clearTimeout(this.timer);
    if (this.socket) return;
    const url = new URL("ws", location.href);
    url.protocol = url.protocol.replace("http", "ws");
    url.hash = url.search = "";
    const socket = this.socket = new WebSocket(url);
    socket.binaryType = "arraybuffer";
    socket.addEventListener("message", ({data}) => {
      if (this.socket !== socket) return;
      this.pause = FIRST_MS;
      this.expect();
      try {
        this.heard(unpack(data));
      } catch (error) {
        console.error("a message of the mapper makes no sense:", error);
        this.again();
      }
    });
    socket.addEventListener("close", () => { if (this.socket === socket) this.again(); });
    this.expect();
  }

  expect() {
    clearTimeout(this.watch);
    this.watch = setTimeout(() => this.again(), SILENT_MS);
  }

  // Hear no more of this one, and open another one later.
  again() {
    this.stop();
    this.timer = setTimeout(() => this.start(), this.pause);
    this.pause = Math.min(2 * this.pause, LAST_MS);
  }

  stop() {
    clearTimeout(this.timer);
    clearTimeout(this.watch);
    const {socket} = this;
    this.socket = null;
    socket?.close();
    if (socket) this.closed();
  }

  say(message) {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(pack(message));
  }
}

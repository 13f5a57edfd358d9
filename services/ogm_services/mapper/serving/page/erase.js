// Erasing an area: corners are clicked, or set in the middle of the view by Space; the polygon is shown, and asked about.
import {write} from "./access.js";
import {tell} from "./banner.js";
import {MAX_CORNERS} from "./constants.js";
import {button, make, say} from "./elements.js";
import {change, subscribe} from "./state.js";
import {element} from "./tables.js";
import {counted} from "./units.js";

const LEAST = 3;  // corners
const SAME_PX = 6;  // corners of a double click
const HOW = "Click the corners of the area to erase. Enter or a double click ends it, Backspace takes a corner back, " +
  "Escape leaves; Space sets a corner in the middle.";
const HOW_BY_FINGERS = "Tap the corners of the area to erase, then Done.";
const fingers = matchMedia("(pointer: coarse)");
const TOOL = "erase";
const SURE = "Make everything inside unknown? Only a map that was saved before brings it back.";

export class EraseTool {
  #view;
  #canvas;
  #corners = null;  // [x, y] of each, m; null: nothing is drawn
  #pointer = null;  // where the next one would be
  #closed = false;
  #text = make("p");
  #finish = button("Done", () => this.#close());
  #sure = button("Erase", () => this.#erase(), {className: "danger"});

  constructor(view, canvas) {
    this.#view = view;
    this.#canvas = canvas;
    canvas.layers.push({name: "erase", draw: (pen, now) => this.#draw(pen, now)});
    view.map.on("click", ({latlng: {lng, lat}}) => this.#add(lng, lat));
    view.map.on("dblclick", () => this.#close());
    view.map.on("mousemove", ({latlng: {lng, lat}}) => this.#point([lng, lat]));
    addEventListener("keydown", (event) => this.#key(event), {capture: true});
    subscribe("tool", (tool) => { if (tool === TOOL) this.#begin(); else if (this.#corners) this.#leave(); });
    element("ask").append(this.#text, make("div", {className: "buttons"},
      button("Cancel", () => change("tool", null)), this.#finish, this.#sure));
  }

  begin() {
    change("tool", TOOL);
  }

  #begin() {
    this.#view.touched = true;  // it stays where it is
    this.#corners = [];
    this.#pointer = null;
    this.#closed = false;
    this.#show();
    element("map").focus();
  }

  #leave() {
    this.#corners = null;
    this.#show();
  }

  #show() {
    element("ask").hidden = !this.#corners;
    say(this.#text, this.#closed ? SURE : fingers.matches ? HOW_BY_FINGERS : HOW);
    this.#finish.hidden = this.#closed;
    this.#finish.disabled = (this.#corners?.length ?? 0) < LEAST;
    this.#sure.hidden = !this.#closed;
    this.#canvas.redraw();
  }

  #add(x, y) {
    if (!this.#corners || this.#closed || this.#corners.length === MAX_CORNERS) return;
    const last = this.#corners.at(-1);
    // The second click of a double click sets no corner.
    if (last && Math.hypot(x - last[0], y - last[1]) * this.#view.now().metre < SAME_PX) return;
    this.#corners.push([x, y]);
    this.#show();
  }

  #point(place) {
    if (!this.#corners || this.#closed) return;
    this.#pointer = place;
    this.#canvas.redraw();
  }

  #close() {
    if (!this.#corners || this.#closed || this.#corners.length < LEAST) return;
    this.#closed = true;
    this.#show();
    this.#sure.focus();
  }

  #key(event) {
    if (!this.#corners || document.querySelector("dialog")) return;
    const onMap = element("map").contains(event.target);
    if (!onMap || this.#closed) return;
    if (event.key === "Enter") this.#close();
    else if (event.key === "Backspace") { this.#corners.pop(); this.#show(); }
    else if (event.key === " ") { const {lng, lat} = this.#view.map.getCenter(); this.#add(lng, lat); }
    else return;
    event.preventDefault();
    event.stopPropagation();
  }

  async #erase() {
    const polygon = this.#corners.flat().map((metres) => metres.toFixed(3)).join(",");
    this.#sure.disabled = true;
    try {
      const erased = await write(`erase?polygon=${polygon}`);
      if (!erased) return;
      tell(`Erased ${counted(erased.cells, "known cell")}.`);
      change("tool", null);
      element("map").focus();
    } catch (error) {
      say(this.#text, `Not erased: ${error.message}`);
    } finally {
      this.#sure.disabled = false;
    }
  }

  #draw(pen, now) {
    if (!this.#corners) return;
    const open = this.#pointer && !this.#closed ? [this.#pointer] : [];
    const all = [...this.#corners, ...open].map(([x, y]) => now.toCanvas(x, y));
    pen.beginPath();
    all.forEach(([u, v]) => pen.lineTo(u, v));
    pen.closePath();
    // As the mapper reads it: what a polygon that crosses itself goes around twice is outside.
    pen.fillStyle = this.#closed ? "#e0313166" : "#e0313133";
    pen.fill("evenodd");
    for (const [width, colour] of [[4, "#fff"], [2, "#c92a2a"]]) {
      Object.assign(pen, {lineWidth: width, strokeStyle: colour, lineJoin: "round"});
      pen.stroke();
    }
    for (const [u, v] of all.slice(0, this.#corners.length)) {
      pen.beginPath();
      pen.arc(u, v, 4.5, 0, 2 * Math.PI);
      Object.assign(pen, {fillStyle: "#fff", strokeStyle: "#c92a2a", lineWidth: 2});
      pen.fill();
      pen.stroke();
    }
  }
}

// Tables and keys of colours.
import {make} from "./elements.js";

export const element = (id) => document.getElementById(id);

// Rows of texts or nodes; the first of each is its heading.
export const fill = (id, rows) => element(id).replaceChildren(...rows.map(([name, ...values]) =>
  make("tr", {}, make("th", {scope: "row"}, name), ...values.map((value) => make("td", {}, value)))));

export function chip(colour, text) {
  const key = make("span", {className: "key"});
  key.style.background = colour;
  return make("span", {}, key, text);
}

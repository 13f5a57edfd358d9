// Tables and keys of colours, made of texts: nothing that a robot or a map is called is read as HTML.

export const element = (id) => document.getElementById(id);

export function fill(id, rows, heading) {
  element(id).replaceChildren(...(heading ? [heading] : []).concat(rows).map((texts) => {
    const row = document.createElement("tr");
    for (const text of texts) {
      const cell = document.createElement(texts === heading ? "th" : "td");
      cell.append(text);
      row.append(cell);
    }
    return row;
  }));
}

export function chip(colour, text) {
  const all = document.createElement("span"), key = document.createElement("span");
  key.className = "key";
  key.style.background = colour;
  all.append(key, text);
  return all;
}

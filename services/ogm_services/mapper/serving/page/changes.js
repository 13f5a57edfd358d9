// The buttons that change the map, for whom the mapper lets change it: erase an area, save it, empty it.
import {logOut, refreshAccess, write} from "./access.js";
import {tell} from "./banner.js";
import {ask} from "./dialogs.js";
import {button} from "./elements.js";
import {state, subscribe} from "./state.js";
import {element} from "./tables.js";
import {whole} from "./units.js";

async function save() {
  const saved = await ask({
    title: "Save the map", label: "name", confirm: "Save",
    text: "As it is at this moment, beside those that are saved already. ogm snapshot restore NAME goes on with it.",
    input: {maxLength: 64, autocomplete: "off", name: "name"},
    attempt: (name) => write(`save?name=${encodeURIComponent(name)}`),
  });
  if (saved) tell(`Saved as ${saved.name}, at revision ${whole(saved.revision)}.`);
}

const reset = () => ask({
  title: "Empty the map?", confirm: "Empty it", danger: true, attempt: () => write("reset"),
  text: "Every cell becomes unknown, and what the robots see from now on begins another map. Only a map that was saved brings this one back.",
});

export function startChanges(eraseTool) {
  const buttons = {
    erase: button("Erase an area…", () => eraseTool.begin()),
    save: button("Save…", save),
    reset: button("Empty it…", reset, {className: "danger"}),
  };
  const leave = button("Log out", logOut);
  element("change").append(...Object.values(buttons), leave);
  subscribe("access", ({logged_in, writes}) => {
    for (const [name, made] of Object.entries(buttons)) made.hidden = !writes.includes(name);
    leave.hidden = !logged_in;
    element("changes").hidden = !writes.length;
  });
  let run = null;
  const look = (told) => {
    if (told.run !== run) refreshAccess().catch(() => {});  // the link says when the mapper is gone
    run = told.run;
  };
  subscribe("map", look);
  look(state.map);
}

// Dialogs: one question each, answered by a button, Enter or Escape.
import {button, make, say} from "./elements.js";

// Ask for a text (`label`), or for consent alone. What `attempt(text)` gives is the answer; if it throws, the
// dialog says why and stays. Null: whoever was asked has given up.
export function ask({title, text, label = null, input = {}, confirm, danger = false, attempt = (given) => given}) {
  const given = label === null ? null : make("input", {required: true, spellcheck: false, ...input});
  const wrong = make("p", {role: "alert", className: "wrong"});
  const agree = make("button", {type: "submit", className: danger ? "danger" : "first"}, confirm);
  const heading = make("h2", {id: "question"}, title);
  const form = make("form", {}, heading, make("p", {}, text),
    ...(given ? [make("label", {}, label, given)] : []), wrong,
    make("div", {className: "buttons"}, button("Cancel", () => dialog.close()), agree));
  const dialog = make("dialog", {"aria-labelledby": "question"}, form);
  let answer = null;
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    agree.disabled = true;
    try {
      answer = await attempt(given?.value ?? true);
      dialog.close();
    } catch (error) {
      say(wrong, error.message);
      given?.select();
    } finally {
      agree.disabled = false;
    }
  });
  document.body.append(dialog);
  dialog.showModal();
  return new Promise((resolve) => dialog.addEventListener("close", () => { dialog.remove(); resolve(answer); }));
}

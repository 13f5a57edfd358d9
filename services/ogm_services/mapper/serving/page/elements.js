// Making parts of the document: nothing that a robot or a map is called is read as HTML.

// An element with properties or attributes, and children: nodes or texts.
export function make(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name in made) made[name] = value;
    else made.setAttribute(name, value);
  }
  made.append(...children);
  return made;
}

// A button that does something.
export const button = (text, pressed, properties = {}) => {
  const made = make("button", {type: "button", ...properties}, text);
  made.addEventListener("click", pressed);
  return made;
};

// Say a text only where it is another: a screen reader reads out whatever is said.
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

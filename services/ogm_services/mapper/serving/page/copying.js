// Takes away what is seen: texts to the clipboard, the view as a picture.
import {ground} from "./overlay.js";
import {state} from "./state.js";

export async function copy(text) {
  try {
    await navigator.clipboard.writeText(text);
  } catch {
    // Without HTTPS browsers have no such clipboard, but on this machine.
    const area = document.createElement("textarea");
    area.value = text;
    document.body.append(area);
    area.select();
    document.execCommand("copy");
    area.remove();
  }
}

export async function savePicture(canvas) {
  const copied = document.createElement("canvas");
  canvas.draw(copied, ground());
  const blob = await new Promise((done) => { copied.toBlob(done, "image/png"); });
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = `${state.map.name}-${state.map.revision}.png`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

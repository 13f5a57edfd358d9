// Takes away what is seen: texts to the clipboard, the view as a picture.
import {tell} from "./banner.js";
import {ground} from "./overlay.js";
import {state} from "./state.js";

// `what` has been copied, it is said where all see it.
export async function copy(text, what) {
  tell(await toClipboard(text) ? `Copied: ${what}.` : "This browser lets nothing be copied.");
}

async function toClipboard(text) {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    // Without HTTPS browsers have no such clipboard, but on this machine.
    const area = document.createElement("textarea");
    area.value = text;
    document.body.append(area);
    area.select();
    const done = document.execCommand("copy");
    area.remove();
    return done;
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

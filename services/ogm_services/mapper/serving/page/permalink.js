// The view in the page's address, as #z/x/y: z as of tiles (16: a pixel a cell), x and y of the middle in metres.
import {LEVELS, NATIVE_Z} from "./constants.js";

export function viewIn(hash) {
  const parts = hash.replace(/^#/, "").split("/").map((part) => part.trim() === "" ? NaN : Number(part));
  if (parts.length !== 3 || !parts.every(Number.isFinite)) return null;
  const [z, x, y] = parts;
  return z >= NATIVE_Z - LEVELS && z <= NATIVE_Z + LEVELS ? {zoom: z - NATIVE_Z, x, y} : null;
}

function hashOf(view) {
  const {lat: y, lng: x} = view.map.getCenter(), z = NATIVE_Z + view.map.getZoom();
  return `#${Number(z.toFixed(2))}/${x.toFixed(2)}/${y.toFixed(2)}`;
}

// The address of what is seen at this moment, whether or not the page goes on to fit it.
export const linkTo = (view) => location.href.replace(/#.*/, "") + hashOf(view);

export function startPermalink(view) {
  const go = () => {
    const wanted = viewIn(location.hash);
    if (!wanted) return;
    view.touched = true;
    view.centreOn(wanted.x, wanted.y, wanted.zoom);
  };
  view.map.on("moveend", () => {
    // A view that the page fits is where the page fits it, for whoever opens it.
    const hash = view.touched ? hashOf(view) : "";
    if (hash !== location.hash) history.replaceState(null, "", hash || location.pathname + location.search);
  });
  addEventListener("hashchange", go);
  go();
}

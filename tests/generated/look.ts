// Types that openapi-typescript has generated, at work: what they promise of a map, as JSON.
//
//     node look.js URL
import createClient from "openapi-fetch";
import type { components, paths } from "./mapper";

declare const process: { argv: string[] };

const mapper = createClient<paths>({ baseUrl: process.argv[2] });

function told<T>(answer: { data?: T; error?: components["schemas"]["Problem"] }): T {
  if (answer.data === undefined) throw new Error(answer.error?.detail);
  return answer.data;
}

const status = told(await mapper.GET("/status"));
const { dropped, integrated } = status.scans;
const map = told(await mapper.GET("/map.json", { params: { query: { values: "trinary", region: "-1,-1,1,1" } } }));
const corner: number[] = [map.origin.x, map.origin.y];
const known: number = map.data.filter((value) => value >= 0).length;
const cell = told(await mapper.GET("/cell", { params: { query: { x: 2.25, y: 0.25 } } }));
const likely: boolean = cell.probability !== null && cell.probability > 0.5;
const rays = told(await mapper.GET("/raycast", { params: { query: { x: 0.25, y: 0.25 } } }));
const ends: ("hit" | "unknown" | "none")[] = rays.ends;
const tile = await mapper.GET("/tiles/{z}/{x}/{y}.png", {
  params: { path: { z: 16, x: 0, y: -1 }, query: { palette: "dark" } },
  parseAs: "arrayBuffer",
});
const refused = await mapper.GET("/map.png", { params: { query: { region: "everywhere" } }, parseAs: "blob" });
// @ts-expect-error: there is no such palette
mapper.GET("/map.png", { params: { query: { palette: "rainbow" } } }).catch(() => {});

console.log(
  JSON.stringify({
    status: [status.map, integrated, Object.values(dropped).reduce((sum, count) => sum + count, 0)],
    map: [map.width, map.height, corner, known],
    cell: [cell.ix, cell.iy, likely],
    rays: [rays.ranges, ends],
    tile: [tile.response.status, told(tile).byteLength > 100],
    refused: [refused.error?.status, refused.error?.type],
  }),
);

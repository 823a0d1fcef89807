// How long parts of the player take in Node, without a browser: the depth order of 60,000 rows, and the sidecars of a
// package with the detail of their first quality. Medians of the CPU time of `RUNS` runs after as many to warm up.
//
//     node web/bench/parts.mjs PACKAGE
import { readFileSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { gunzipSync } from "node:zlib";
import { build } from "esbuild";

const RUNS = 15;
const ROWS = 60_000;

const code = `
  export { DepthSorter, depthView } from "./render/sort.ts";
  export { readSidecar, readDetail, canonicalMeans } from "./format/sidecar.ts";
  export { ColumnReader } from "./format/rangecoder.ts";
  export { readMedia } from "./format/mp4.ts";`;
const resolveDir = fileURLToPath(new URL("../src", import.meta.url));
const stdin = { contents: code, resolveDir, loader: "ts" };
const made = await build({ stdin, bundle: true, format: "esm", target: "es2022", write: false });
const url = `data:text/javascript;base64,${Buffer.from(made.outputFiles[0].text).toString("base64")}`;
const { DepthSorter, depthView, readSidecar, readDetail, canonicalMeans, ColumnReader, readMedia } = await import(url);

function median(work) {
  const times = Array.from({ length: 2 * RUNS }, () => {
    const begun = process.cpuUsage();
    work();
    const { user, system } = process.cpuUsage(begun);
    return (user + system) / 1e3;
  });
  return times
    .slice(RUNS)
    .sort((a, b) => a - b)
    [RUNS >> 1].toFixed(1);
}

const means = Float32Array.from({ length: 3 * ROWS }, () => Math.random() * 4 - 2);
const worldToCamera = Float64Array.of(1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 5, 0, 0, 0, 1);
const sorter = new DepthSorter();
console.log(
  `depth order of ${ROWS} rows: ${median(() => sorter.order(means, depthView({ near: 0.01, worldToCamera })))} ms`,
);

const folder = process.argv[2];
const { qualities } = JSON.parse(readFileSync(`${folder}/airgs.json`, "utf8"));
const { grid, tiers, keeps } = JSON.parse(gunzipSync(readFileSync(`${folder}/group/1.json.gz`)));
const coarsest = qualities.at(-1).coarser;
for (const [t, { count }] of tiers.entries()) {
  if (!count || keeps) continue;
  const [sidecar, key] = [`keyframe/T${t}/1.bin`, `keyframe/T${t}/Q0/1.m4s`];
  const [data, media] = [sidecar, key].map((path) => new Uint8Array(readFileSync(`${folder}/${path}`)));
  const read = () => {
    const shared = readSidecar(data, { count, placed: count }, grid, coarsest, sidecar);
    const reader = new ColumnReader(readMedia(media, key).columns, key);
    canonicalMeans(readDetail(reader, shared, grid, qualities[0].coarser, coarsest), grid, qualities[0].coarser);
  };
  console.log(`${sidecar} and its detail, ${count} rows, ${data.length} bytes: ${median(read)} ms`);
}

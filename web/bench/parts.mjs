// How long parts of the player take in Node, without a browser: the depth order of 60,000 rows, and of a package the
// sidecars with the detail of their first quality, and a frame of its first segment: what our own code does between the
// decoder of H.264, for which pictures of noise stand, and the GPU. Medians of the CPU time of `RUNS` runs after as many
// to warm up, and the least.
//
//     node web/bench/parts.mjs PACKAGE
import { readFileSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

const RUNS = 15;
const ROWS = 60_000;

const code = `
  export { DepthSorter, depthView } from "./render/sort.ts";
  export { Tables } from "./format/package.ts";
  export { readKeyframeTier } from "./format/files.ts";
  export { concat } from "./format/collections.ts";
  export { atlasSamples, checkLuma } from "./format/atlas.ts";
  export { readLuma } from "./media/decoder.ts";
  export { decodeDeltas } from "./media/spaces.ts";
  export { Samples } from "./render/samples.ts";`;
const resolveDir = fileURLToPath(new URL("../src", import.meta.url));
const stdin = { contents: code, resolveDir, loader: "ts" };
const made = await build({ stdin, bundle: true, format: "esm", target: "es2022", write: false });
const url = `data:text/javascript;base64,${Buffer.from(made.outputFiles[0].text).toString("base64")}`;
const { DepthSorter, depthView, Tables, readKeyframeTier, concat, ...rest } = await import(url);
const { atlasSamples, checkLuma, readLuma, decodeDeltas, Samples } = rest;

const cpuMs = ({ user, system }) => (user + system) / 1e3;

function statistics(times) {
  const sorted = times.slice(times.length >> 1).sort((a, b) => a - b);
  return `${sorted[sorted.length >> 1].toFixed(1)} ms, at least ${sorted[0].toFixed(1)}`;
}

function median(work) {
  const times = Array.from({ length: 2 * RUNS }, () => {
    const begun = process.cpuUsage();
    work();
    return cpuMs(process.cpuUsage(begun));
  });
  return statistics(times);
}

const means = Float32Array.from({ length: 3 * ROWS }, () => Math.random() * 4 - 2);
const worldToCamera = Float64Array.of(1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 5, 0, 0, 0, 1);
const sorter = new DepthSorter();
console.log(
  `depth order of ${ROWS} rows: ${median(() => sorter.order(means, depthView({ near: 0.01, worldToCamera })))}`,
);

const folder = process.argv[2];
const file = (path) => new Uint8Array(readFileSync(`${folder}/${path}`));
const tables = Tables.parse(file("airgs.json"));
await tables.add("group/1.json.gz", file("group/1.json.gz"));
const [root, table] = [tables.root, tables.group(0)];
const space = { group: 0, quality: 0, tiers: root.levels[0].tiers };
const found = Array.from({ length: space.tiers }, (_, tier) => {
  const [sidecar, media] = tables.keyframeFiles(0, tier, 0);
  if (!sidecar) return [];
  const [data, picture] = [file(sidecar), file(media)];
  const read = () => readKeyframeTier(root, table, { group: 0, tier, quality: 0 }, data, picture);
  console.log(`${sidecar} and its detail, ${table.tiers[tier].count} rows, ${data.length} bytes: ${median(read)}`);
  return [read()];
}).flat();
const joined = (name, kind) =>
  concat(
    kind,
    found.map((tier) => tier[name]),
  );
const positions = {
  means: joined("means", Float32Array),
  units: joined("units", Float32Array),
  depths: joined("depths", Uint8Array),
};
const atlas = table.levels[0];
const noise = Uint8Array.from({ length: atlasSamples(atlas) }, () => 16 + 220 * Math.random());
const samples = { layout: "planar", data: noise, offset: 0, stride: atlas.width, step: 1 };
const parts = { copies: [], checks: [], frames: [] };
/** In the place of a decoder: the times of the parts of each picture. */
const decoder = {
  async decode({ frames }, take) {
    for (let t = 0; t < frames; t++) {
      const begun = process.cpuUsage();
      const luma = new Uint8Array(noise.length);
      readLuma(samples, atlas.width, noise.length / atlas.width, { planar: null }, luma);
      const copied = process.cpuUsage();
      try {
        checkLuma(luma, 0, "noise");
      } catch {}
      const checked = process.cpuUsage();
      take(t, luma);
      const ended = process.cpuUsage();
      if (!t) continue; // the first may be that of slopes
      const since = (a, b) => cpuMs(b) - cpuMs(a);
      parts.copies.push(since(begun, copied));
      parts.checks.push(since(copied, checked));
      parts.frames.push(since(begun, ended));
    }
  },
};
const [where] = tables.deltaFiles(0, 0);
const delta = { ...space, segment: 0, level: 0, positions, bytes: file(where), where };
const uploads = [];
const gpu = new Samples(new Proxy({}, { get: () => () => 1 << 12 }), atlas); // WebGL that does nothing
/** In the place of the page: what it does with a frame before WebGL has it. */
function show(t, { bases, luma }) {
  const begun = process.cpuUsage();
  if (!t) gpu.reset();
  if (bases) gpu.change(bases);
  gpu.setLuma(luma);
  gpu.upload();
  if (t) uploads.push(cpuMs(process.cpuUsage(begun)));
}
for (let run = 0; run < RUNS; run++) await decodeDeltas(tables, delta, decoder, show, {});
const [copies, checks, frames] = Object.values(parts).map(statistics);
console.log(`a frame of ${where}, ${atlas.rows} rows in ${atlas.planes.length} planes: ${frames}`);
console.log(
  `  of which copying its samples ${copies}; its checksum ${checks}; what the page does ${statistics(uploads)}`,
);

// Builds what `npm pack` packs beside package.json and README.md: dist/, with types, and the licence.
import { spawnSync } from "node:child_process";
import { copyFile, rm } from "node:fs/promises";
import { fileURLToPath } from "node:url";
import { bundle } from "./bundle.mjs";

const here = (path) => fileURLToPath(new URL(path, import.meta.url));
const entries = { "airgs-player": here("../src/airgs-player.ts"), "airgs-frames": here("../src/airgs-frames.ts") };
for (const engine of ["three", "spark", "playcanvas"]) entries[engine] = here(`../adapters/${engine}.ts`);
const external = ["three", "@sparkjsdev/spark", "playcanvas"];

await rm(here("../dist"), { recursive: true, force: true });
await bundle(entries, here("../dist"), { minify: true, splitting: true, external });
const types = spawnSync(here("../node_modules/.bin/tsc"), ["--project", here("../tsconfig.npm.json")], {
  stdio: "inherit",
});
await copyFile(here("../../LICENSE"), here("../LICENSE"));
process.exitCode = types.status ?? 1;

// Runs the tests in test/unit with Node's own runner: node unit.mjs [NAME …]
import { spawnSync } from "node:child_process";
import { readdirSync } from "node:fs";
import { basename } from "node:path";
import { fileURLToPath } from "node:url";
import { bundle } from "./bundle.mjs";
import "./tables.mjs";

const here = (path) => fileURLToPath(new URL(path, import.meta.url));
const wanted = process.argv.slice(2);
const all = readdirSync(here("../test/unit")).filter((file) => file.endsWith(".test.ts"));
const names = all
  .map((file) => basename(file, ".ts"))
  .filter((name) => !wanted.length || wanted.includes(name.split(".")[0]));
const folder = here("../out/unit");
await bundle(Object.fromEntries(names.map((name) => [name, here(`../test/unit/${name}.ts`)])), folder, {
  platform: "node",
  sourcemap: "inline",
});
const files = names.map((name) => `${folder}/${name}.js`);
process.exit(
  spawnSync(process.execPath, ["--enable-source-maps", "--test", ...files], { stdio: "inherit" }).status ?? 1,
);

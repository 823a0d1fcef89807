// Runs the tests in test/unit with Node's own runner, all in one process: node unit.mjs [NAME …]
import { spawnSync } from "node:child_process";
import { mkdirSync, readdirSync, writeFileSync } from "node:fs";
import { basename } from "node:path";
import { fileURLToPath } from "node:url";
import { bundle } from "./bundle.mjs";

const here = (path) => fileURLToPath(new URL(path, import.meta.url));
const wanted = process.argv.slice(2);
const all = readdirSync(here("../test/unit")).filter((file) => file.endsWith(".test.ts"));
const files = all.filter((file) => !wanted.length || wanted.includes(basename(file).split(".")[0]));
const folder = here("../out/unit");
mkdirSync(folder, { recursive: true });
const entry = `${folder}/all.ts`;
writeFileSync(entry, files.map((file) => `import ${JSON.stringify(here(`../test/unit/${file}`))};\n`).join(""));
await bundle({ all: entry }, folder, { platform: "node", sourcemap: "inline" });
const command = ["--enable-source-maps", `${folder}/all.js`];
process.exit(spawnSync(process.execPath, command, { stdio: "inherit" }).status ?? 1);

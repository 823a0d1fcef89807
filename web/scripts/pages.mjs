// Builds the scripts of the pages in test/pages into out/pages, for the tests that open them in a browser.
import { readdirSync } from "node:fs";
import { basename } from "node:path";
import { fileURLToPath } from "node:url";
import { bundle } from "./bundle.mjs";

const here = (path) => fileURLToPath(new URL(path, import.meta.url));
const files = readdirSync(here("../test/pages")).filter((file) => file.endsWith(".ts"));
const entries = Object.fromEntries(files.map((file) => [basename(file, ".ts"), here(`../test/pages/${file}`)]));
entries["airgs-more"] = here("../src/airgs-more.ts");
entries["airgs-sound"] = here("../src/play/sound.ts");
await bundle(entries, here("../out/pages"), { sourcemap: "inline" });

// Builds the examples, engines and all, into out/examples: open out/examples/NAME/index.html?src=PACKAGE/ from a server.
import { copyFile } from "node:fs/promises";
import { fileURLToPath } from "node:url";
import { bundle } from "./bundle.mjs";

const here = (path) => fileURLToPath(new URL(path, import.meta.url));
const names = ["spark", "playcanvas"];
await bundle(
  Object.fromEntries(names.map((name) => [`${name}/${name}`, here(`../examples/${name}/${name}.ts`)])),
  here("../out/examples"),
  { minify: true },
);
for (const name of names)
  await copyFile(here(`../examples/${name}/index.html`), here(`../out/examples/${name}/index.html`));

// Builds the examples, engines and all, into out/examples as a project of their own does: with Vite, from this package as
// npm packs and installs it, whose types they are checked with. index.html is the page of README.md, with a fox to
// play; those of engines are NAME/index.html?src=PACKAGE/.
import { execFileSync } from "node:child_process";
import { cp, readFile, rm, writeFile } from "node:fs/promises";
import { fileURLToPath } from "node:url";
import { build } from "vite";

const here = (path) => fileURLToPath(new URL(path, import.meta.url));
const project = here("../out/project");
const run = (program, ...words) =>
  execFileSync(program, words, { cwd: project, stdio: ["ignore", "ignore", "inherit"] });

await rm(project, { recursive: true, force: true });
await cp(here("../examples"), project, { recursive: true });
const [, page] = (await readFile(here("../README.md"), "utf8")).match(/^```html\n(.*?)^```$/ms);
await writeFile(`${project}/index.html`, page);
await writeFile(`${project}/package.json`, '{ "type": "module" }\n');
const options = {
  ...{ target: "ES2022", lib: ["ES2022", "DOM", "DOM.Iterable"], module: "ESNext", moduleResolution: "Bundler" },
  ...{ types: [], strict: true, skipLibCheck: true, allowImportingTsExtensions: true, noEmit: true },
};
await writeFile(`${project}/tsconfig.json`, JSON.stringify({ compilerOptions: options }));
run("npm", "pack", "--silent", here(".."));
const { name, version } = JSON.parse(await readFile(here("../package.json"), "utf8"));
run("npm", "install", "--silent", "--offline", "--no-audit", "--no-fund", `${name}-${version}.tgz`);
run(here("../node_modules/.bin/tsc"));
const input = ["", "three/", "spark/", "playcanvas/"].map((folder) => `${project}/${folder}index.html`);
const made = { outDir: here("../out/examples"), emptyOutDir: true, chunkSizeWarningLimit: 1e4 };
await build({ root: project, base: "./", logLevel: "warn", build: { ...made, rollupOptions: { input } } });
await cp(here("../../manifests/showcase/fox.airgs"), here("../out/examples/fox.airgs"), { recursive: true });

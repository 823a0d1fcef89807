// What the adapters to other renderers cost: plays a package in each of the examples in headless Chromium, and prints a
// line of JSON for each: frames shown in so many seconds, and by V8's profiler what one cost the page, milliseconds: to
// become Gaussians, to be handed to the engine, and all else but waiting, which is mostly the engine's.
//
//     node web/bench/engines.mjs URL [--seconds 2] [--size 640x360] [--rung Q0+L0] [--screenshots FOLDER]
//
// URL is that of a package at airgs-serve. Time begins with the first picture. The browser is that of the environment
// variable CHROMIUM, else /usr/bin/chromium; SwiftShader draws, three.js' own GaussianSplat with WebGL 2.
import { readFile } from "node:fs/promises";
import { setTimeout } from "node:timers/promises";
import { fileURLToPath } from "node:url";
import { parseArgs } from "node:util";
import { chromium } from "playwright-core";
import { bundle } from "../scripts/bundle.mjs";

const { values, positionals } = parseArgs({
  allowPositionals: true,
  options: {
    seconds: { type: "string", default: "2" },
    size: { type: "string", default: "640x360" },
    rung: { type: "string", default: "" },
    screenshots: { type: "string" },
  },
});
const [width, height] = values.size.split("x").map(Number);
const FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"];
const WAITS = new Set(["(idle)", "(program)", "(root)"]);

/** Milliseconds of a profile in `names` and what they call, by name, and in all else. */
function sharesOf({ nodes, samples, timeDeltas }, names) {
  const owners = new Map(); // the outermost of `names` around each node
  for (const { id, callFrame, children = [] } of nodes) {
    const { functionName: name } = callFrame;
    owners.set(id, owners.get(id) ?? (names.includes(name) ? name : WAITS.has(name) && name !== "(root)" ? "" : null));
    for (const child of children) owners.set(child, owners.get(id));
  }
  const sums = Object.fromEntries([...names, "else"].map((name) => [name, 0]));
  samples.forEach((id, i) => {
    const owner = owners.get(id) ?? "else";
    if (owner) sums[owner] += timeDeltas[i] / 1e3;
  });
  return sums;
}

const here = (path) => fileURLToPath(new URL(path, import.meta.url));
const src = positionals[0];
const { origin } = new URL(src);
const browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: FLAGS });
for (const name of ["three", "spark", "playcanvas"]) {
  await bundle({ [name]: here(`../examples/${name}/${name}.ts`) }, here("../out/bench"));
  const page = await browser.newPage({ viewport: { width, height } });
  const html = (await readFile(here(`../examples/${name}/index.html`), "utf8")).replace(".ts", ".js");
  await page.route(`${origin}/bench/**`, (route) =>
    route.request().url().endsWith(".js")
      ? route.fulfill({ path: here(`../out/bench/${name}.js`), contentType: "text/javascript" })
      : route.fulfill({ body: html, contentType: "text/html" }),
  );
  page.on("pageerror", (error) => console.error(name, error));
  await page.goto(`${origin}/bench/?${new URLSearchParams({ src, ...(values.rung && { rung: values.rung }) })}`);
  await page.waitForFunction("document.querySelector('output').textContent", null, { timeout: 60_000 });
  const session = await page.context().newCDPSession(page);
  await session.send("Profiler.enable");
  await session.send("Profiler.start");
  await page.evaluate(() => {
    window.shown = 0;
    new MutationObserver(() => window.shown++).observe(document.querySelector("output"), { childList: true });
  });
  const begun = performance.now();
  await setTimeout(1e3 * Number(values.seconds));
  const shown = await page.evaluate("window.shown");
  const seconds = (performance.now() - begun) / 1e3;
  const { profile } = await session.send("Profiler.stop");
  const ms = sharesOf(profile, ["gaussians", "show"]);
  const aFrame = Object.fromEntries(Object.entries(ms).map(([what, sum]) => [what, Number((sum / shown).toFixed(1))]));
  const words = await page.textContent("output");
  console.log(JSON.stringify({ name, shown, seconds: Number(seconds.toFixed(2)), msAFrame: aFrame, words }));
  if (values.screenshots) await page.screenshot({ path: `${values.screenshots}/${name}.png` });
  await page.close();
}
await browser.close();

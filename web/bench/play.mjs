// Plays a page with <airgs-player> for a while in headless Chromium, and prints what it cost: a line of JSON every
// `--every` seconds, and the sums at the end.
//
//     node web/bench/play.mjs URL [--seconds 60] [--every 10] [--size 640x360] [--screenshot FILE]
//
// Of the page: the time of the first picture, frames shown and dropped, stalls, tasks of the main thread over 50 ms, bytes
// of its heap after a collection of garbage, and what the console said (Chromium complains there of a VideoFrame that was
// never closed). The browser is that of the environment variable CHROMIUM, else /usr/bin/chromium; pictures are drawn
// by SwiftShader.
import { setTimeout } from "node:timers/promises";
import { parseArgs } from "node:util";
import { chromium } from "playwright-core";

const { values, positionals } = parseArgs({
  allowPositionals: true,
  options: {
    seconds: { type: "string", default: "60" },
    every: { type: "string", default: "10" },
    size: { type: "string", default: "640x360" },
    screenshot: { type: "string" },
  },
});
const [width, height] = values.size.split("x").map(Number);
const FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--js-flags=--expose-gc"];

function observe() {
  window.longTasks = [];
  new PerformanceObserver((list) => {
    for (const entry of list.getEntries())
      window.longTasks.push([Math.round(entry.startTime), Math.round(entry.duration)]);
  }).observe({ type: "longtask", buffered: true });
  addEventListener("firstpicture", () => (window.firstPictureMs = Math.round(performance.now())), true);
}

function look() {
  const { player } = document.querySelector("airgs-player");
  if (!player) return null;
  window.gc?.();
  const { stats, currentTime, duration, rung, renderScale } = player;
  const heap = performance.memory?.usedJSHeapSize;
  return {
    stats: { ...stats },
    currentTime,
    duration,
    rung,
    renderScale,
    heap,
    firstPictureMs: window.firstPictureMs,
    longTasks: window.longTasks,
  };
}

const browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: FLAGS });
const page = await browser.newPage({ viewport: { width, height } });
const said = [];
page.on("console", (message) => said.push(`${message.type()}: ${message.text()}`));
page.on("pageerror", (error) => said.push(`error: ${error}`));
await page.addInitScript(observe);
await page.goto(positionals[0]);
const begun = performance.now();
const seconds = () => (performance.now() - begun) / 1e3;
while (seconds() < Number(values.seconds)) {
  await setTimeout(1e3 * Math.min(Number(values.every), Math.max(0, Number(values.seconds) - seconds())));
  console.log(JSON.stringify({ second: Math.round(seconds()), ...(await page.evaluate(look)) }));
}
if (values.screenshot) await page.screenshot({ path: values.screenshot });
console.log(JSON.stringify({ version: browser.version(), said }));
await browser.close();

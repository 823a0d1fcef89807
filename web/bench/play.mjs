// Plays a page with <airgs-player> for a while in headless Chromium, and prints what it cost: a line of JSON every
// `--every` seconds, and the sums at the end.
//
//     node web/bench/play.mjs URL [--seconds 60] [--every 10] [--size 640x360] [--screenshot FILE] [--profile]
//
// Of the page: the time of the first picture, frames shown and dropped, stalls, tasks of the main thread over 50 ms, bytes
// of its heap after a collection of garbage, and what the console said (Chromium complains there of a VideoFrame that was
// never closed). With --profile also the time of our own JavaScript, of the page a frame shown and of each of its workers a
// frame shown or passed over, by V8's profiler, with that of WebGL apart, which waits for the renderer; and bytes that
// came before the first picture, headers aside. The browser is that of the environment variable CHROMIUM, else
// /usr/bin/chromium; pictures are drawn by SwiftShader.
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
    profile: { type: "boolean", default: false },
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
  addEventListener(
    "firstpicture",
    () => {
      window.firstPictureMs ??= Math.round(performance.now());
      window.firstPicture();
    },
    true,
  );
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

const NOT_OURS = new Set(["(idle)", "(program)", "(root)"]);
const GL =
  /^(tex|draw|bind|buffer|get|use|uniform|clear|compile|link|attach|create|delete|read|blit|flush|finish|fence|client)[A-Za-z]*(Image|Storage|Arrays|Elements|Buffer|Parameter|Program|Shader|Texture|Pixels|Sync|Data|Instanced|Framebuffer|Uniform|Info|Log|[1-4][fi]v?)[A-Za-z0-9]*$/;
const LONGEST_MS = 2;

/** Starts V8's profiler in a page and its workers; the function that is returned gives milliseconds of each. */
async function profile(page) {
  const session = await page.context().newCDPSession(page);
  const workers = new Map();
  const answers = new Map();
  let last = 0;
  const ask = (sessionId, method) => {
    const message = JSON.stringify({ id: ++last, method });
    session.send("Target.sendMessageToTarget", { sessionId, message });
    return new Promise((resolve) => answers.set(last, resolve));
  };
  session.on("Target.receivedMessageFromTarget", ({ message }) => {
    const { id, result } = JSON.parse(message);
    answers.get(id)?.(result);
  });
  session.on("Target.attachedToTarget", ({ sessionId }) => workers.set(sessionId, `worker ${workers.size + 1}`));
  await session.send("Target.setAutoAttach", { autoAttach: true, waitForDebuggerOnStart: false, flatten: false });
  await setTimeout(500);
  for (const method of ["Profiler.enable", "Profiler.start"]) {
    await session.send(method);
    await Promise.all([...workers.keys()].map((id) => ask(id, method)));
  }
  return async () => {
    const own = { page: ownMs(await session.send("Profiler.stop")) };
    for (const [id, name] of workers) own[name] = ownMs(await ask(id, "Profiler.stop"));
    return own;
  };
}

/** Milliseconds in functions and in built-in ones that they call, collecting garbage included: our own, and of WebGL. After
 * a longer time than LONGEST_MS between two samples, another program had the core.
 */
function ownMs({ profile: { nodes, samples, timeDeltas } }) {
  const names = new Map(nodes.map(({ id, callFrame }) => [id, callFrame.functionName]));
  const sums = { own: 0, gl: 0 };
  samples.forEach((id, i) => {
    const name = names.get(id);
    if (!NOT_OURS.has(name)) sums[GL.test(name) ? "gl" : "own"] += Math.min(timeDeltas[i] / 1e3, LONGEST_MS);
  });
  return sums;
}

const browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: FLAGS });
const page = await browser.newPage({ viewport: { width, height } });
const said = [];
page.on("console", (message) => said.push(`${message.type()}: ${message.text()}`));
page.on("pageerror", (error) => said.push(`error: ${error}`));
const came = { player: 0, package: 0 };
let bytesBeforeFirstPicture = null;
page.on("requestfinished", async (request) => {
  const { responseBodySize } = await request.sizes();
  came[/[.](js|html)([?]|$)/.test(request.url()) ? "player" : "package"] += responseBodySize;
});
await page.exposeFunction("firstPicture", () => (bytesBeforeFirstPicture ??= { ...came }));
await page.addInitScript(observe);
await page.goto(positionals[0]);
/** Frames that were shown, and that were decoded and passed over. */
const playing = async () => {
  const stats = await page.evaluate("document.querySelector('airgs-player')?.player.stats");
  return { shown: stats?.framesShown ?? 0, passed: (stats?.framesShown ?? 0) + (stats?.framesDropped ?? 0) };
};
while (values.profile && (await playing()).shown < 2) await setTimeout(100);
const profiled = values.profile ? await profile(page) : null;
const before = await playing();
const begun = performance.now();
const seconds = () => (performance.now() - begun) / 1e3;
while (seconds() < Number(values.seconds)) {
  await setTimeout(1e3 * Math.min(Number(values.every), Math.max(0, Number(values.seconds) - seconds())));
  console.log(JSON.stringify({ second: Math.round(seconds()), ...(await page.evaluate(look)) }));
}
if (profiled) {
  const own = await profiled();
  const after = await playing();
  const frames = { shown: after.shown - before.shown, passed: after.passed - before.passed };
  const a = (ms, count) => Number((ms / count).toFixed(2));
  const ownMsAFrame = Object.fromEntries(
    Object.entries(own).map(([where, { own, gl }]) => {
      const count = where === "page" ? frames.shown : frames.passed;
      return [where, { own: a(own, count), gl: a(gl, count) }];
    }),
  );
  console.log(JSON.stringify({ frames, ownMsAFrame, bytesBeforeFirstPicture }));
}
if (values.screenshot) await page.screenshot({ path: values.screenshot });
console.log(JSON.stringify({ version: browser.version(), said }));
await browser.close();

// Opens pages in headless Chromium, which it starts once: some at a time, each in a context of its own, which shares
// nothing with others.
//
//     node open.mjs
//
// For every line of its input, {number, url, script} as JSON, it prints a line {number, report, messages, failed} when the
// page has reported: what its promise `window.report` gave (or null), what it logged, and its errors. It ends with its
// input. A script, null for none, runs on the page before those of the page.
//
// A page can ask for input as people give it: `await window.drive("keyboard.press", "a")` calls that method of Playwright's
// Page; `mouse.…`, `touchscreen.…`, `setViewportSize`, `emulateMedia` and `screenshot` are there as well, and `cdp.…`
// for what only the DevTools protocol can do.
//
// The browser is that of the environment variable CHROMIUM. WebGL is drawn by SwiftShader, with or without a GPU. Pages are
// put together without it: that takes half of the time.
import { createInterface } from "node:readline";
import { setTimeout } from "node:timers/promises";
import { chromium } from "playwright-core";

const TIMEOUT_MS = 180_000;
const AT_ONCE = 2; // pages
/** Of a request that the page itself ended: what a seek or another level made needless. */
const GIVEN_UP = "net::ERR_ABORTED";
const FLAGS = [
  "--autoplay-policy=no-user-gesture-required",
  "--use-angle=swiftshader",
  "--enable-unsafe-swiftshader",
  "--disable-gpu-compositing",
];

async function late() {
  await setTimeout(TIMEOUT_MS, undefined, { ref: false });
  throw new Error(`no report after ${TIMEOUT_MS} ms`);
}

/** What came of a page. */
async function visit(browser, { url, script }) {
  const context = await browser.newContext();
  const page = await context.newPage();
  page.setDefaultTimeout(TIMEOUT_MS);
  const messages = [];
  const failed = [];
  page.on("console", (message) => messages.push({ type: message.type(), text: message.text() }));
  page.on("pageerror", (error) => failed.push(String(error)));
  page.on("requestfailed", (request) => {
    const error = request.failure()?.errorText;
    if (error !== GIVEN_UP) failed.push(`${request.url()}: ${error}`);
  });
  const devtools = await context.newCDPSession(page);
  await page.exposeFunction("drive", async (method, ...args) => {
    const path = method.split(".");
    if (path[0] === "cdp") return await devtools.send(path.slice(1).join("."), ...args);
    const owner = path.length > 1 ? page[path[0]] : page;
    const came = await owner[path.at(-1)](...args);
    return method === "screenshot" ? null : came;
  });
  if (script) await page.addInitScript(script);
  let report = null;
  try {
    await page.goto(url);
    report = (await Promise.race([page.evaluate(() => window.report), late()])) ?? null;
  } catch (error) {
    failed.push(String(error));
  }
  await context.close();
  return { report, messages, failed };
}

const browser = await chromium.launch({ executablePath: process.env.CHROMIUM, args: FLAGS });
const lines = createInterface({ input: process.stdin })[Symbol.asyncIterator]();
async function work() {
  for (let next = await lines.next(); !next.done; next = await lines.next()) {
    const { number, ...page } = JSON.parse(next.value);
    console.log(JSON.stringify({ number, ...(await visit(browser, page)) }));
  }
}
await Promise.all(Array.from({ length: AT_ONCE }, work));
await browser.close();

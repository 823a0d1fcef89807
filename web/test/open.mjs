// Opens a page in headless Chromium and prints what came of it as one line of JSON:
// {report, messages, failed}: what the page's promise `window.report` gave (or null), what it logged, and its errors.
//
//     node open.mjs URL [SCRIPT]
//
// A script runs on the page before those of the page.
//
// A page can ask for input as people give it: `await window.drive("keyboard.press", "a")` calls that method of Playwright's
// Page; `mouse.…`, `touchscreen.…`, `setViewportSize`, `emulateMedia` and `screenshot` are there as well, and `cdp.…`
// for what only the DevTools protocol can do.
//
// The browser is that of the environment variable CHROMIUM. Pictures are drawn by SwiftShader, with or without a GPU.
import { setTimeout } from "node:timers/promises";
import { chromium } from "playwright-core";

const TIMEOUT_MS = 60_000;
const FLAGS = ["--autoplay-policy=no-user-gesture-required", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"];

async function late() {
  await setTimeout(TIMEOUT_MS, undefined, { ref: false });
  throw new Error(`no report after ${TIMEOUT_MS} ms`);
}

const [url, script] = process.argv.slice(2);
const browser = await chromium.launch({ executablePath: process.env.CHROMIUM, args: FLAGS });
const page = await browser.newPage();
page.setDefaultTimeout(TIMEOUT_MS);
const messages = [];
const failed = [];
page.on("console", (message) => messages.push({ type: message.type(), text: message.text() }));
page.on("pageerror", (error) => failed.push(String(error)));
page.on("requestfailed", (request) => failed.push(`${request.url()}: ${request.failure()?.errorText}`));
const devtools = await page.context().newCDPSession(page);
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
await browser.close();
console.log(JSON.stringify({ report, messages, failed }));

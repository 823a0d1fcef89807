// Opens a page in headless Chromium and prints what came of it as one line of JSON:
// {report, messages, failed}: what the page's promise `window.report` gave (or null), what it logged, and its errors.
//
//     node open.mjs URL
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

const [url] = process.argv.slice(2);
const browser = await chromium.launch({ executablePath: process.env.CHROMIUM, args: FLAGS });
const page = await browser.newPage();
page.setDefaultTimeout(TIMEOUT_MS);
const messages = [];
const failed = [];
page.on("console", (message) => messages.push({ type: message.type(), text: message.text() }));
page.on("pageerror", (error) => failed.push(String(error)));
page.on("requestfailed", (request) => failed.push(`${request.url()}: ${request.failure()?.errorText}`));
let report = null;
try {
  await page.goto(url);
  report = (await Promise.race([page.evaluate(() => window.report), late()])) ?? null;
} catch (error) {
  failed.push(String(error));
}
await browser.close();
console.log(JSON.stringify({ report, messages, failed }));

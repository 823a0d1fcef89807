// Opens a page that plays a scene in headless Chromium and writes a picture of it two seconds after the first one is shown.
//
//     node screenshot.mjs URL FILE.png [WIDTH HEIGHT]
//
// The page has an <airgs-player>. The browser is that of the environment
// variable CHROMIUM. Exit status 2 with one line where there is no picture after a minute.
import { setTimeout } from "node:timers/promises";
import { chromium } from "playwright-core";

const TIMEOUT_MS = 60_000;
const PLAY_MS = 2000;
const FLAGS = ["--autoplay-policy=no-user-gesture-required", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"];

const [url, file, width = "1280", height = "720"] = process.argv.slice(2);
let browser;
try {
  browser = await chromium.launch({ executablePath: process.env.CHROMIUM, args: FLAGS });
  const page = await browser.newPage({ viewport: { width: Number(width), height: Number(height) } });
  page.setDefaultTimeout(TIMEOUT_MS);
  await page.goto(url);
  await page.waitForFunction(() => document.querySelector("airgs-player")?.player?.stats.framesShown > 0);
  await setTimeout(PLAY_MS);
  await page.screenshot({ path: file });
} catch (error) {
  console.error(`${url}: no picture: ${String(error).split("\n")[0]}`);
  process.exitCode = 2;
} finally {
  await browser?.close();
}

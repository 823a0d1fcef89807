// Opens a page that plays a scene in headless Chromium and writes a picture of its middle frame in the best rung.
//
//     node screenshot.mjs URL FILE.png [WIDTH HEIGHT]
//
// The page has an <airgs-player>. It is drawn on the CPU: so it plays in a small window until the best rung is shown, or
// for BEST_MS, then stands still to be drawn with all pixels, without the large button. The browser is that of the
// environment variable CHROMIUM. Exit status 2 with one line where there is no picture after a minute.
import { setTimeout } from "node:timers/promises";
import { chromium } from "playwright-core";

const TIMEOUT_MS = 60_000;
const BEST_MS = 10_000;
const DRAWN_MS = 1000;
const FLAGS = ["--autoplay-policy=no-user-gesture-required", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"];
const PLAYER = `document.querySelector("airgs-player")?.player`;
const BEST = `${PLAYER}.rungs.every((rung) => !(rung.psnr > ${PLAYER}.rungs[${PLAYER}.rung].psnr))`;

const [url, file, width = "1120", height = "630"] = process.argv.slice(2);
let browser;
try {
  browser = await chromium.launch({ executablePath: process.env.CHROMIUM, args: FLAGS });
  const small = { width: Number(width) >> 2, height: Number(height) >> 2 };
  const page = await browser.newPage({ viewport: small, bypassCSP: true });
  page.setDefaultTimeout(TIMEOUT_MS);
  await page.goto(url);
  await page.waitForFunction(`${PLAYER}?.stats.framesShown > 0`);
  await page.waitForFunction(BEST, null, { timeout: BEST_MS }).catch(() => {});
  await page.evaluate(`${PLAYER}.pause()`);
  await page.setViewportSize({ width: Number(width), height: Number(height) });
  await page.evaluate(`${PLAYER}.seek(${PLAYER}.duration / 2)`);
  await page.waitForFunction(`!${PLAYER}.seeking && ${PLAYER}.canvas.width === ${width}`);
  await page.mouse.move(Number(width) / 2, Number(height) / 2); // for the controls
  await page.locator("airgs-player .big").evaluate((button) => button.remove()); // it hides what is shown
  await setTimeout(DRAWN_MS);
  await page.screenshot({ path: file });
} catch (error) {
  console.error(`${url}: no picture: ${String(error).split("\n")[0]}`);
  process.exitCode = 2;
} finally {
  await browser?.close();
}

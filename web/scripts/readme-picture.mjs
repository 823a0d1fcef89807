// Writes docs/browser.png, the first picture of the README: the player with its figures, as Chromium shows it.
//
//     node readme-picture.mjs URL FILE.png        URL: /player.html?src=… of a running airgs-serve
//
// Pictures are drawn on the CPU: it plays in a small window and slowly, then stands still to be drawn with all pixels.
// The browser is that of the environment variable CHROMIUM.
import { setTimeout } from "node:timers/promises";
import { chromium } from "playwright-core";

const [WIDTH, HEIGHT] = [1120, 630];
const SPEED = 0.5;
const PLAY_MS = 25_000;
const MOMENT_S = 0;
const PLAYER = `document.querySelector("airgs-player").player`;
const FLAGS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"];

const [url, file] = process.argv.slice(2);
const browser = await chromium.launch({ executablePath: process.env.CHROMIUM, args: FLAGS });
try {
  const page = await browser.newPage({ viewport: { width: WIDTH >> 2, height: HEIGHT >> 2 }, bypassCSP: true });
  await page.goto(url);
  await page.waitForFunction(`${PLAYER}?.stats.framesShown > 0`);
  await page.evaluate(`${PLAYER}.speed = ${SPEED}`);
  await page.keyboard.press("i");
  await setTimeout(PLAY_MS);
  await page.keyboard.press("k");
  await page.evaluate(`${PLAYER}.speed = 1`);
  await page.setViewportSize({ width: WIDTH, height: HEIGHT });
  await page.evaluate(`${PLAYER}.seek(${MOMENT_S})`);
  await page.waitForFunction(`!${PLAYER}.seeking && ${PLAYER}.canvas.width === ${WIDTH}`);
  await page.mouse.move(WIDTH / 2, HEIGHT / 2); // for the controls
  await setTimeout(1000);
  await page.screenshot({ path: file });
} finally {
  await browser.close();
}

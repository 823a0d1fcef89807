// The page that is shipped, with the player that it loads, used as people use it: by mouse and keys. Reports what came of it.

import type { Player } from "../../src/airgs.ts";
import type { AirgsPlayer } from "../../src/airgs-player.ts";

declare global {
  interface Window {
    drive(method: string, ...values: unknown[]): Promise<unknown>;
    report: Promise<object>;
  }
}

const [WIDTH, HEIGHT] = [32, 18]; // of the pictures that are compared
const STILL = 12; // pictures
const PHONE = { width: 390, height: 844 };

const wait = (ms: number) => new Promise((resolve) => setTimeout(resolve, ms));
const frame = () => new Promise((resolve) => requestAnimationFrame(resolve));
const node = () => document.querySelector("airgs-player") as AirgsPlayer; // null at first
const player = () => node().player as unknown as Player;
const find = (selector: string) => node()?.shadowRoot?.querySelector<HTMLElement>(selector) ?? null;

/** Resolves when a condition holds. Throws after a while. */
async function until(what: string, condition: () => boolean, seconds = 30): Promise<void> {
  const end = performance.now() + 1e3 * seconds;
  while (!condition()) {
    if (performance.now() > end) throw new Error(`${what}: not within ${seconds} s`);
    await wait(20);
  }
}

/** r, g, b, a of what is on the screen, made small. */
async function picture(): Promise<number[]> {
  const small = Object.assign(document.createElement("canvas"), { width: WIDTH, height: HEIGHT });
  const pen = small.getContext("2d", { willReadFrequently: true }) as CanvasRenderingContext2D;
  for (let look = 0; look < 300; look++) {
    player().camera = { ...player().camera }; // something to draw
    await frame();
    pen.drawImage(player().canvas, 0, 0, WIDTH, HEIGHT);
    const { data } = pen.getImageData(0, 0, WIDTH, HEIGHT);
    if (data.some((value, i) => i % 4 < 3 && value > 30)) return [...data];
  }
  throw new Error("nothing is drawn");
}

/** Until the camera has come to rest: it is where it was for some pictures, however long they take. */
async function rest(): Promise<void> {
  const place = () => JSON.stringify(player().camera.position);
  for (let still = 0, before = ""; still < STILL; before = place()) {
    await frame();
    still = before === place() ? still + 1 : 0;
  }
}

async function drag(from: readonly [number, number], to: readonly [number, number]): Promise<void> {
  await window.drive("mouse.move", ...from);
  await window.drive("mouse.down");
  await window.drive("mouse.move", ...to, { steps: 4 });
  await wait(150); // no fling
  await window.drive("mouse.up");
}

async function click(target: HTMLElement | null): Promise<void> {
  const { left, top, width, height } = (target as HTMLElement).getBoundingClientRect();
  await window.drive("mouse.click", left + width / 2, top + height / 2);
}

const press = (key: string) => window.drive("keyboard.press", key);

async function look() {
  await press(" ");
  await until("a pause", () => player().paused);
  const [first, before] = [player().camera.position, await picture()];
  await drag([300, 120], [320, 120]);
  await rest();
  const [turned, after] = [player().camera.position, await picture()];
  await press("r");
  await rest();
  return { first, turned, home: player().camera.position, before, after };
}

async function scrub() {
  await player().seek(0);
  await until("the first frame", () => !player().seeking);
  const before = await picture();
  const { left, top, width, height } = (find(".timeline") as HTMLElement).getBoundingClientRect();
  const at = (share: number) => [left + share * width, top + height / 2] as const;
  await drag(at(0.05), at(0.7));
  await until("another frame", () => !player().seeking);
  return { before, after: await picture(), time: player().currentTime };
}

async function choose() {
  await click(find('[aria-label^="Quality"]'));
  const items = [...(find(".menu")?.querySelectorAll<HTMLElement>("[role=menuitemradio]") ?? [])];
  const last = items.at(-1) as HTMLElement;
  const name = last.querySelector(".name")?.textContent;
  await click(last);
  await press("k");
  const shown = () => player().rungs[player().rung ?? -1]?.name;
  const label = () => find('[aria-label^="Quality"]')?.ariaLabel;
  await until("the rung", () => shown() === name && label() !== "Quality: Auto"); // which may have shown it, too
  return { name, shown: shown(), label: label() };
}

async function phone() {
  await window.drive("setViewportSize", PHONE);
  await until("the size", () => player().canvas.height / player().canvas.width > 1.5);
  const rectangle = (of: HTMLElement | null) => (of as HTMLElement).getBoundingClientRect().toJSON();
  const { scrollWidth, scrollHeight } = document.documentElement;
  const { touchAction } = getComputedStyle(find(".scene") as HTMLElement);
  return { element: rectangle(node()), bar: rectangle(find(".bar")), page: [scrollWidth, scrollHeight], touchAction };
}

async function run(): Promise<object> {
  await window.drive("setViewportSize", { width: 720, height: 405 });
  await until("the element", () => !!find(".poster"));
  const named = find(".poster")?.textContent;
  await until("a picture", () => player().stats.framesShown > 0, 60);
  const poster = () => getComputedStyle(find(".poster") as HTMLElement).opacity;
  await until("the poster to go", () => poster() === "0");
  return {
    named,
    title: document.title,
    look: await look(),
    scrub: await scrub(),
    choose: await choose(),
    phone: await phone(),
  };
}

window.report = run();

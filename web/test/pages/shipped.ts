// What a page with <airgs-player> shows, or what comes of it, by what `globalThis.asked` asks: `touches`, `widths`, or
// nothing but that it plays. It runs before the page's own scripts, or after them.
import type { Player } from "../../src/airgs.ts";
import type { AirgsPlayer } from "../../src/airgs-player.ts";
import { lacks } from "../support/lacking.ts";

interface Asked {
  /** What is taken away first. */
  lacks?: string;
  /** Selectors of what must be in the element, too. */
  wanted?: string[];
  /** What people do to it: "m" for the key, "button" or "scene" for a click. */
  touches?: string[];
  /** Of the window, pixels. */
  widths?: number[];
}

declare global {
  interface Window {
    drive(method: string, ...values: unknown[]): Promise<unknown>;
    report: Promise<object>;
    asked?: Asked;
  }
}

const { asked = {} } = window;
const wait = (ms: number) => new Promise((resolve) => setTimeout(resolve, ms));
const frame = () => new Promise((resolve) => requestAnimationFrame(resolve));
const node = () => document.querySelector<AirgsPlayer>("airgs-player");
const player = () => node()?.player as unknown as Player | undefined;
const find = (selector: string) => node()?.shadowRoot?.querySelector<HTMLElement>(selector);
const loaded = new Promise((resolve) => addEventListener("load", resolve));

/** What is there when some frames were shown, or when a card says why they are not. */
async function shows(): Promise<object> {
  const goes = () => (player()?.stats.framesShown ?? 0) > 5 && (asked.wanted ?? []).every(find);
  while (!goes() && !find(".card")) await wait(20);
  const { width, height } = find(".card")?.getBoundingClientRect() ?? {};
  return {
    frames: player()?.stats.framesShown,
    paused: player()?.paused,
    camera: player()?.camera,
    labels: find(".seam")?.textContent,
    asked: performance.getEntriesByType("resource").map(({ name }) => name),
    text: find(".card")?.innerText,
    seen: find(".card")?.checkVisibility({ opacityProperty: true }),
    width,
    height,
  };
}

/** Whether it is muted, first and after each touch. */
async function touched(touches: string[]): Promise<object> {
  Object.defineProperty(navigator, "userActivation", { value: { hasBeenActive: false } });
  await loaded;
  while (!(player()?.hasSound && (player()?.stats.framesShown ?? 0) > 3)) await wait(50);
  const seen = [player()?.muted];
  for (const touch of touches) {
    if (touch === "m") await window.drive("keyboard.press", "m");
    const { x = 0, y = 0 } = find("[data-icon=sound], [data-icon=mute]")?.getBoundingClientRect() ?? {};
    if (touch === "button") await window.drive("mouse.click", x + 9, y + 9);
    if (touch === "scene") await window.drive("mouse.click", 300, 200);
    await wait(500);
    seen.push(player()?.muted);
  }
  return { seen, attribute: node()?.muted };
}

/** How a list of packages is laid out in windows of some widths. */
async function laidOut(widths: number[]): Promise<object> {
  await loaded;
  const seen: object[] = [];
  for (const width of widths) {
    await window.drive("setViewportSize", { width, height: 800 });
    await frame();
    await frame();
    const cards = [...document.querySelectorAll("li")].map((card) => card.getBoundingClientRect());
    const images = [...document.querySelectorAll("img")];
    const pictures = images.map((image) => image.getBoundingClientRect().toJSON());
    const abreast = cards.filter(({ top }) => top === cards[0].top).length;
    const there: boolean[] = [];
    for (const image of images) {
      image.scrollIntoView(); // they are not fetched before
      await image.decode();
      there.push(image.naturalWidth > 0);
    }
    scrollTo(0, 0);
    seen.push({ width, needs: document.documentElement.scrollWidth, abreast, pictures, loaded: there });
  }
  return { seen };
}

if (asked.lacks) lacks[asked.lacks]();
window.report = asked.touches ? touched(asked.touches) : asked.widths ? laidOut(asked.widths) : shows();

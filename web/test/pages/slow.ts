// The element on a screen that is too slow: every picture keeps the page busy. Reports what it shows, and what the panel
// says, when that has made a difference; then the same of a rung that is chosen. Query: src, busy (ms).
import type { Player } from "../../src/airgs.ts";
import type { AirgsPlayer } from "../../src/airgs-player.ts";
import "../../src/airgs-player.ts";

const query = new URLSearchParams(location.search);
const busyMs = Number(query.get("busy"));
const { drawArrays } = WebGL2RenderingContext.prototype;
WebGL2RenderingContext.prototype.drawArrays = function (...args) {
  drawArrays.apply(this, args);
  if (this.getParameter(this.FRAMEBUFFER_BINDING) !== null) return;
  for (const end = performance.now() + busyMs; performance.now() < end; );
};

const element = document.createElement("airgs-player") as AirgsPlayer;
element.style.cssText = "display: block; width: 240px; height: 135px";
for (const flag of ["controls", "autoplay", "loop"]) element.toggleAttribute(flag, true);
element.setAttribute("src", query.get("src") ?? "");
document.body.append(element);
const player = element.player as unknown as Player;

async function until(what: string, condition: () => boolean): Promise<void> {
  const end = performance.now() + 90e3;
  while (!condition()) {
    if (performance.now() > end) throw new Error(`${what}: not within 90 s; ${JSON.stringify(player.stats)}`);
    await new Promise((resolve) => setTimeout(resolve, 50));
  }
}

const panel = () => element.shadowRoot?.querySelector<HTMLElement>(".panel")?.innerText ?? "";
const shown = () => player.rungs[player.rung ?? -1]?.name;

async function run(): Promise<object> {
  await until("a picture", () => player.stats.framesShown > 0);
  element.shadowRoot?.querySelector<HTMLElement>('[aria-label="Figures"]')?.click();
  const first = shown();
  await until("a rung that is held", () => player.stats.held !== null && shown() !== first);
  await until("a sentence", () => panel().includes("Held"));
  const held = { rung: shown(), panel: panel(), stats: player.stats };
  element.setAttribute("quality", first);
  await until("the rung that was chosen", () => shown() === first);
  await until("no sentence", () => !panel().includes("Held"));
  return { first, held, chosen: { rung: shown(), panel: panel(), stats: player.stats } };
}

Object.assign(window, { report: run() });

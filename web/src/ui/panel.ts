// The panel of figures, for those who want to know.

import type { RungInfo } from "../play/rungs.ts";
import type { PlayerStats } from "../play/statistics.ts";
import { ranked, stripes } from "./colours.ts";
import type { Desk } from "./desk.ts";
import { iconButton, make, write } from "./dom.ts";
import { History } from "./graph.ts";
import { decibels, rate, rungTitle, SOURCES, size } from "./words.ts";

/** In words: how exactly this browser decodes (the player refuses to play where it does not). */
const LUMA = { exact: "exact", invertible: "exact, by a table" } as const;

/** What is shown: its label, and its text; null: not at all. */
const ROWS: readonly (readonly [string, (desk: Desk, stats: PlayerStats) => string | null])[] = [
  ["Quality", ({ rungs }, { rung }) => nameOf(rungs[rung ?? -1])],
  ["PSNR claimed", (_, { psnr }) => decibels(psnr)],
  ["Throughput", (_, { throughputBps }) => rate(throughputBps)],
  ["Buffer", (_, { bufferS }) => `${bufferS.toFixed(1)} s`],
  ["Received", (_, { bytes }) => size(bytes)],
  ["Tiles shown", (_, { tiles }) => (tiles && tiles.all > 1 ? `${tiles.shown} of ${tiles.all}` : null)],
  [
    "Frames shown",
    (_, { framesShown, displayFps: fps }) => `${framesShown} (${fps.toFixed(fps < 10 ? 1 : 0)} pictures/s)`,
  ],
  ["Frames dropped", (_, { framesShown, framesDropped }) => shareOf(framesDropped, framesShown + framesDropped)],
  ["Stalls", (_, { stalls, stallS }) => (stalls ? `${stalls} (${stallS.toFixed(1)} s)` : "none")],
  ["Drawn at", ({ picture, scale }) => `${picture.join(" × ")}${scale < 1 ? ` (${Math.round(100 * scale)} %)` : ""}`],
  ["Decoding", (_, { luma }) => (luma ? LUMA[luma] : "–")],
  ["Region", ({ player: { region } }) => (region ? SOURCES[region.source] : "–")],
];

const nameOf = (rung?: RungInfo) => (rung ? `${rate(1000 * rung.kbps)} · ${rung.name}` : "–");
const shareOf = (part: number, all: number) => `${part}${all ? ` (${((100 * part) / all).toFixed(1)} %)` : ""}`;

export class Panel {
  readonly node: HTMLElement;
  readonly close = iconButton("close", "Close");
  readonly #cells = ROWS.map(() => make("dd"));
  readonly #history: History;
  /** Those that the legend shows. */
  #rungs: readonly RungInfo[] = [];
  readonly #legend = make("div", { class: "legend" });

  constructor(readonly desk: Desk) {
    const rows = ROWS.map(([label], i) => make("div", {}, make("dt", {}, label), this.#cells[i]));
    this.#history = new History(desk);
    this.node = make(
      "section",
      { class: "panel", part: "panel", "aria-label": "Figures of playing", hidden: true, tabindex: -1 },
      make("div", { class: "head" }, "Figures", this.close),
      make("dl", {}, ...rows),
      this.#history.node,
      this.#legend,
    );
  }

  get open(): boolean {
    return !this.node.hidden;
  }

  toggle(open = !this.open): void {
    this.node.hidden = !open;
  }

  /** Four times a second, shown or not: the history goes on. */
  update(): void {
    this.#history.sample();
    if (!this.open) return;
    const { stats } = this.desk.player;
    ROWS.forEach(([, text], i) => {
      const words = text(this.desk, stats);
      this.#cells[i].parentElement!.hidden = words === null;
      write(this.#cells[i], words ?? "");
    });
    this.#history.draw();
    if (this.#rungs !== this.desk.rungs) this.#fillLegend();
  }

  #fillLegend(): void {
    const { rungs: all, colours } = this.desk;
    this.#rungs = all;
    if (all.length < 2) return;
    const rungs = ranked(all);
    const parts = rungs.map((rung, i) => ({ start: i, stop: i + 1, colour: colours[rung] }));
    const scale = make("i", { style: `background: ${stripes(parts, rungs.length)}` });
    this.#legend.replaceChildren(rungTitle(all[rungs[0]]), scale, rungTitle(all[rungs.at(-1)!]));
  }
}

// The panel of figures, for those who want to know.

import type { RungInfo } from "../play/rungs.ts";
import { ranked, stripes } from "./colours.ts";
import type { Desk } from "./desk.ts";
import { iconButton, make, write } from "./dom.ts";
import { History } from "./graph.ts";
import { decibels, rate, rungTitle, SOURCES, size } from "./words.ts";

const ROWS = {
  rung: "Quality",
  psnr: "PSNR claimed",
  throughput: "Throughput",
  buffer: "Buffer",
  bytes: "Received",
  tiles: "Tiles shown",
  fps: "Frames shown",
  dropped: "Frames dropped",
  stalls: "Stalls",
  picture: "Drawn at",
  luma: "Decoding",
  region: "Region",
} as const;

/** In words: how exactly this browser decodes (the player refuses to play where it does not). */
const LUMA = { exact: "exact", invertible: "exact, by a table" } as const;

export class Panel {
  readonly node: HTMLElement;
  readonly close = iconButton("close", "Close");
  readonly #cells = Object.fromEntries(Object.keys(ROWS).map((key) => [key, make("dd")])) as Record<
    keyof typeof ROWS,
    HTMLElement
  >;
  readonly #history: History;
  /** Those that the legend shows. */
  #rungs: readonly RungInfo[] = [];
  readonly #legend = make("div", { class: "legend" });

  constructor(readonly desk: Desk) {
    const list = make("dl");
    for (const [key, label] of Object.entries(ROWS)) {
      list.append(make("div", {}, make("dt", {}, label), this.#cells[key as keyof typeof ROWS]));
    }
    this.#history = new History(desk);
    this.node = make(
      "section",
      { class: "panel", part: "panel", "aria-label": "Figures of playing", hidden: true, tabindex: -1 },
      make("div", { class: "head" }, "Figures", this.close),
      list,
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

  /** Four times a second, shown or not: the history has to be kept. */
  update(): void {
    this.#history.sample();
    if (!this.open) return;
    for (const [key, text] of Object.entries(this.#texts())) write(this.#cells[key as keyof typeof ROWS], text);
    this.#history.draw();
    if (this.#rungs !== this.desk.rungs) this.#fillLegend();
    const { tiles } = this.desk.player.stats;
    this.#cells.tiles.parentElement!.hidden = !tiles || tiles.all < 2;
  }

  #texts(): Record<keyof typeof ROWS, string> {
    const { player, scale, picture } = this.desk;
    const { stats } = player;
    const rung = stats.rung === null ? undefined : this.desk.rungs[stats.rung];
    const all = stats.framesShown + stats.framesDropped;
    return {
      rung: rung ? `${rate(1000 * rung.kbps)} · ${rung.name}` : "–",
      psnr: decibels(stats.psnr),
      throughput: rate(stats.throughputBps),
      buffer: `${stats.bufferS.toFixed(1)} s`,
      bytes: size(stats.bytes),
      tiles: stats.tiles ? `${stats.tiles.shown} of ${stats.tiles.all}` : "–",
      fps: `${stats.framesShown} (${stats.displayFps.toFixed(stats.displayFps < 10 ? 1 : 0)} pictures/s)`,
      dropped: `${stats.framesDropped}${all ? ` (${((100 * stats.framesDropped) / all).toFixed(1)} %)` : ""}`,
      stalls: stats.stalls ? `${stats.stalls} (${stats.stallS.toFixed(1)} s)` : "none",
      picture: `${picture[0]} × ${picture[1]}${scale < 1 ? ` (${Math.round(100 * scale)} %)` : ""}`,
      luma: stats.luma ? LUMA[stats.luma] : "–",
      region: player.region ? SOURCES[player.region.source] : "–",
    };
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

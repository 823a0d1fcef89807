// The panel of figures, for those who want to know, with the last minute in a small picture.
import type { RungInfo } from "../play/rungs.ts";
import type { PlayerStats } from "../play/statistics.ts";
import type { Desk } from "./desk.ts";
import { iconButton, make, OTHERS, write } from "./dom.ts";
import { cost, decibels, ranked, rate, SOURCES, size, stripes } from "./words.ts";

/** In words: how exactly this browser decodes (the player refuses to play where it does not). */
const LUMA = { exact: "exact", invertible: "exact, by a table" } as const;

const BY = { display: "this screen drops frames", decoder: "decoding is too slow" } as const;

/** What is shown: its label, and its text; null: not at all. */
const ROWS: readonly (readonly [string, (desk: Desk, stats: PlayerStats) => string | null])[] = [
  ["Frames", ({ still }) => (still ? "1 frame" : null)],
  ["Quality", (desk, { rung }) => nameOf(desk, desk.rungs[rung ?? -1])],
  ["Held", ({ rungs }, { held }) => held && `at ${rungs[held.rung]?.name}: ${BY[held.by]}`],
  ["PSNR claimed", (_, { psnr }) => decibels(psnr)],
  ["Throughput", (_, { throughputBps }) => rate(throughputBps)],
  ["Buffer", (_, { bufferS }) => `${bufferS.toFixed(1)} s`],
  ["Received", (_, { bytes }) => size(bytes)],
  [
    "Frames shown",
    (_, { framesShown, displayFps: fps }) => `${framesShown} (${fps.toFixed(fps < 10 ? 1 : 0)} pictures/s)`,
  ],
  [
    "Frames dropped",
    (_, { framesShown, framesDropped: all, droppedByDecoder: some }) =>
      `${shareOf(all, framesShown + all)}${some ? `, ${some} by the decoder` : ""}`,
  ],
  ["Stalls", (_, { stalls, stallS }) => (stalls ? `${stalls} (${stallS.toFixed(1)} s)` : "none")],
  ["Drawn at", ({ picture, scale }) => `${picture.join(" × ")}${scale < 1 ? ` (${Math.round(100 * scale)} %)` : ""}`],
  ["Decoding", (_, { luma }) => (luma ? LUMA[luma] : "–")],
  ["Region", ({ player: { region } }) => (region ? SOURCES[region.source] : "–")],
];

/** What time does, which a still has not. */
const TIMED = ["Throughput", "Buffer", "Frames shown", "Frames dropped", "Stalls"];

const nameOf = (desk: Desk, rung?: RungInfo) => (rung ? `${cost(desk, rung)} · ${rung.name}` : "–");
const shareOf = (part: number, all: number) => `${part}${all ? ` (${((100 * part) / all).toFixed(1)} %)` : ""}`;

export class Panel {
  readonly node: HTMLElement;
  readonly close = iconButton(OTHERS.close, "Close");
  readonly #cells = ROWS.map(() => make("dd"));
  readonly #history: History;
  #rungs: readonly RungInfo[] = [];
  readonly #legend = make("div", { class: "legend" });

  constructor(readonly desk: Desk) {
    const rows = ROWS.map(([label], i) => make("div", {}, make("dt", {}, label), this.#cells[i]));
    this.#history = new History(desk);
    const attributes = {
      class: "panel",
      part: "panel",
      "aria-label": "Figures of playing",
      hidden: true,
      tabindex: -1,
    };
    const parts = [make("div", { class: "head" }, "Figures", this.close), make("dl", {}, ...rows)];
    this.node = make("section", attributes, ...parts, this.#history.node, this.#legend);
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
    ROWS.forEach(([label, text], i) => {
      const words = this.desk.still && TIMED.includes(label) ? null : text(this.desk, stats);
      this.#cells[i].parentElement!.hidden = words === null;
      write(this.#cells[i], words ?? "");
    });
    this.#history.node.hidden = this.#legend.hidden = this.desk.still;
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
    this.#legend.replaceChildren("Smallest", scale, "Best");
  }
}

const SHOWN_MS = 60_000;
const HEIGHT = 76;
const STRIP = 5;
const TOP = 16;
const FLOOR = HEIGHT - STRIP - 3;

interface Sample {
  readonly at: number;
  readonly bps: number;
  readonly bufferS: number;
  readonly rung: number | null;
}

/** The last minute: throughput as an area, the buffer as a line, the rung as a coloured strip below. */
class History {
  readonly node: HTMLElement;
  readonly #canvas = make("canvas", { "aria-hidden": "true" });
  readonly #words = make("figcaption");
  #samples: Sample[] = [];

  constructor(readonly desk: Desk) {
    this.node = make("figure", { class: "graph" }, this.#canvas, this.#words);
  }

  sample(): void {
    const { throughputBps, bufferS, rung } = this.desk.player.stats;
    const at = performance.now();
    this.#samples.push({ at, bps: throughputBps || 0, bufferS, rung });
    while (at - this.#samples[0].at > SHOWN_MS) this.#samples.shift();
  }

  draw(): void {
    const width = this.#canvas.clientWidth;
    const ratio = window.devicePixelRatio;
    const pen = this.#canvas.getContext("2d");
    if (!pen || width === 0) return;
    const size = { width: Math.round(width * ratio), height: Math.round(HEIGHT * ratio) };
    if (this.#canvas.width !== size.width || this.#canvas.height !== size.height) Object.assign(this.#canvas, size);
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, HEIGHT);
    const samples = this.#samples;
    const now = performance.now();
    const x = ({ at }: Sample) => width - ((now - at) / SHOWN_MS) * width;
    const most = (name: "bps" | "bufferS") => Math.max(1, ...samples.map((one) => one[name]));
    const path = (name: "bps" | "bufferS") => {
      const highest = most(name);
      pen.beginPath();
      for (const sample of samples) pen.lineTo(x(sample), FLOOR - (sample[name] / highest) * (FLOOR - TOP));
    };
    path("bps");
    pen.lineTo(width, FLOOR);
    if (samples.length) pen.lineTo(x(samples[0]), FLOOR);
    pen.fillStyle = "#ffffff2e";
    pen.fill();
    path("bufferS");
    Object.assign(pen, { strokeStyle: "#8ecbff", lineWidth: 1.5, lineJoin: "round" });
    pen.stroke();
    samples.forEach((sample, i) => {
      if (sample.rung === null) return;
      const next = samples[i + 1];
      const from = x(sample);
      pen.fillStyle = this.desk.colours[sample.rung] ?? "#fff";
      pen.fillRect(from, HEIGHT - STRIP, (next ? x(next) : width) - from + 0.5, STRIP);
    });
    const upTo = `throughput up to ${rate(most("bps"))}, buffer up to ${most("bufferS").toFixed(1)} s`;
    write(this.#words, `Last minute: ${upTo}`);
  }
}

// The last minute in a small picture: throughput as an area, the buffer as a line, the rung as a coloured strip below.
import type { Desk } from "./desk.ts";
import { make, write } from "./dom.ts";
import { rate } from "./words.ts";

const SHOWN_MS = 60_000;
const HEIGHT = 76;
const STRIP = 5;
const TOP = 16;

interface Sample {
  readonly at: number;
  readonly bps: number;
  readonly bufferS: number;
  readonly rung: number | null;
}

export class History {
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
    const [wide, high] = [Math.round(width * ratio), Math.round(HEIGHT * ratio)];
    if (this.#canvas.width !== wide || this.#canvas.height !== high) {
      Object.assign(this.#canvas, { width: wide, height: high });
    }
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, HEIGHT);
    const most = {
      bps: Math.max(1, ...this.#samples.map((one) => one.bps)),
      bufferS: Math.max(1, ...this.#samples.map((one) => one.bufferS)),
    };
    this.#area(pen, width, most.bps);
    this.#line(pen, width, most.bufferS);
    this.#strip(pen, width);
    write(this.#words, `Last minute: throughput up to ${rate(most.bps)}, buffer up to ${most.bufferS.toFixed(1)} s`);
  }

  #x(sample: Sample, width: number): number {
    return width - ((performance.now() - sample.at) / SHOWN_MS) * width;
  }

  #path(pen: CanvasRenderingContext2D, width: number, value: (sample: Sample) => number): void {
    const floor = HEIGHT - STRIP - 3;
    pen.beginPath();
    for (const sample of this.#samples) {
      pen.lineTo(this.#x(sample, width), floor - value(sample) * (floor - TOP));
    }
  }

  #area(pen: CanvasRenderingContext2D, width: number, most: number): void {
    const floor = HEIGHT - STRIP - 3;
    this.#path(pen, width, (sample) => sample.bps / most);
    pen.lineTo(width, floor);
    if (this.#samples.length) pen.lineTo(this.#x(this.#samples[0], width), floor);
    pen.fillStyle = "#ffffff2e";
    pen.fill();
  }

  #line(pen: CanvasRenderingContext2D, width: number, most: number): void {
    this.#path(pen, width, (sample) => sample.bufferS / most);
    pen.strokeStyle = "#8ecbff";
    pen.lineWidth = 1.5;
    pen.lineJoin = "round";
    pen.stroke();
  }

  #strip(pen: CanvasRenderingContext2D, width: number): void {
    this.#samples.forEach((sample, i) => {
      if (sample.rung === null) return;
      const next = this.#samples[i + 1];
      const from = this.#x(sample, width);
      pen.fillStyle = this.desk.colours[sample.rung] ?? "#fff";
      pen.fillRect(from, HEIGHT - STRIP, (next ? this.#x(next, width) : width) - from + 0.5, STRIP);
    });
  }
}

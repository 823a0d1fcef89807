// A player that only pretends: a ring of coloured balls, seen from its camera on a 2D canvas, and a network that can fail.

import type { ViewState } from "../../src/format/region.ts";
import type { Region } from "../../src/format/types.ts";
import type { Problem } from "../../src/play/playback.ts";
import type { RungInfo } from "../../src/play/rungs.ts";
import type { PlayerStats } from "../../src/play/statistics.ts";
import type { Part, PlayerLike } from "../../src/ui/desk.ts";

export interface Pretence {
  duration: number;
  live: boolean;
  region: Region | null;
  rungs: RungInfo[];
  /** How far ahead of the picture there is something. */
  aheadS: number;
  /** Rejects `open`. */
  refusal: Error | null;
  /** Milliseconds until `open` is done. */
  openMs: number;
  hasSound: boolean;
}

export const REGION: Region = {
  source: "cameras",
  width: 1280,
  height: 720,
  fov_y: 45,
  near: 0.05,
  turn: 12,
  places: [{ position: [0, -0.6, -4], focus: [0, 0, 0], up: [0, -1, 0], reach: 1.2 }],
};

export const RUNGS: RungInfo[] = [
  { name: "Q2+L0", psnr: 31.4, kbps: 420, onLadder: true },
  { name: "Q1+L1", psnr: 35.2, kbps: 980, onLadder: true },
  { name: "Q1+L2", psnr: 38.9, kbps: 2100, onLadder: true },
  { name: "Q0+L3", psnr: 43.1, kbps: 5200, onLadder: true },
];

const PLAIN: Pretence = {
  duration: 84,
  live: false,
  region: REGION,
  rungs: RUNGS,
  aheadS: 14,
  refusal: null,
  openMs: 20,
  hasSound: false,
};

/** Seconds of a segment: rungs change with them. */
const SEGMENT_S = 4;
const BALLS = 260;

export class FakePlayer extends EventTarget implements PlayerLike {
  readonly pretence: Pretence;
  paused = true;
  ended = false;
  speed = 1;
  quality = "auto";
  readonly fps = 24;
  readonly vr = false;
  muted: boolean;
  volume: number;
  closed = false;
  /** What was asked of it, in order. */
  readonly calls: string[] = [];
  policy: string;
  loop: boolean;
  #opened = false;
  #time = 0;
  #camera: ViewState = { position: [0, 0, -4], forward: [0, 0, 1], up: [0, -1, 0], fovY: 45, near: 0.05 };
  #last = performance.now();
  #request = 0;
  #shown = 0;
  #first = true;

  constructor(
    readonly canvas: HTMLCanvasElement,
    settings: { policy?: string; loop?: boolean; muted?: boolean; volume?: number } = {},
    pretence: Partial<Pretence> = {},
  ) {
    super();
    this.pretence = { ...PLAIN, ...pretence };
    this.policy = settings.policy ?? "robust-mpc";
    this.loop = settings.loop ?? false;
    this.muted = settings.muted ?? false;
    this.volume = settings.volume ?? 1;
  }

  async open(src: string): Promise<void> {
    this.calls.push(`open ${src}`);
    await new Promise((resolve) => setTimeout(resolve, this.pretence.openMs));
    if (this.pretence.refusal) throw this.pretence.refusal;
    this.#opened = true;
    this.#tell("open");
    this.#request = requestAnimationFrame((now) => this.#tick(now));
  }

  play(): void {
    if (this.ended) this.#time = 0;
    this.ended = false;
    this.paused = false;
    this.#tell("play");
  }

  pause(): void {
    this.paused = true;
    this.#tell("pause");
  }

  async seek(seconds: number): Promise<void> {
    this.calls.push(`seek ${seconds.toFixed(2)}`);
    this.#time = seconds;
    this.ended = false;
    this.#tell("time");
  }

  async enterVr(): Promise<void> {
    this.calls.push("enterVr");
  }

  leaveVr(): void {
    this.calls.push("leaveVr");
  }

  drawn(): null {
    return null;
  }

  close(): void {
    this.closed = true;
    cancelAnimationFrame(this.#request);
  }

  resize(width: number, height: number): void {
    Object.assign(this.canvas, { width, height });
    this.#draw();
  }

  get hasSound(): boolean {
    return this.pretence.hasSound;
  }

  get live(): boolean {
    return this.pretence.live;
  }

  get region(): Region | null {
    return this.#opened ? this.pretence.region : null;
  }

  get rungs(): RungInfo[] {
    return this.#opened ? this.pretence.rungs : [];
  }

  get duration(): number {
    return this.#opened ? this.pretence.duration : 0;
  }

  get currentTime(): number {
    return this.#time;
  }

  get rung(): number | null {
    return this.#opened ? this.#rungAt(this.#time) : null;
  }

  get buffered(): Part[] {
    const first = Math.floor(this.#time / SEGMENT_S);
    const stop = Math.min(this.duration, this.#time + this.pretence.aheadS);
    const parts: Part[] = [];
    for (let s = first; s * SEGMENT_S < stop; s++) {
      const rung = this.#rungAt(s * SEGMENT_S);
      parts.push({ start: s * SEGMENT_S, stop: Math.min((s + 1) * SEGMENT_S, this.duration), rung });
    }
    return parts;
  }

  get camera(): ViewState {
    return this.#camera;
  }

  set camera(camera: ViewState) {
    this.#camera = camera;
    this.#draw();
  }

  get stats(): PlayerStats {
    const wobble = Math.sin(performance.now() / 4000);
    return {
      throughputBps: 7e6 * (1 + 0.4 * wobble),
      bufferS: Math.min(this.pretence.aheadS, this.duration - this.#time) * (0.9 + 0.1 * wobble),
      rung: this.rung,
      bytes: 3.4e6 + 6e5 * this.#time,
      framesShown: this.#shown,
      droppedByDecoder: 0,
      droppedByDisplay: 3,
      framesDropped: 3,
      displayFps: 60,
      psnr: this.rung === null ? null : this.rungs[this.rung].psnr,
      stalls: 1,
      stallS: 0.4,
      held: null,
      luma: "exact",
    };
  }

  /** As a real one would tell it. */
  problem(detail: Problem): void {
    this.#tell("problem", detail);
  }

  #rungAt(time: number): number {
    const chosen = this.rungs.findIndex((rung) => rung.name === this.quality);
    if (chosen >= 0) return chosen;
    return [0, 1, 2, 2, 3, 3, 3, 2, 3, 3, 1, 2, 3][Math.floor(time / SEGMENT_S) % 13] % this.rungs.length;
  }

  #tell(name: string, detail: unknown = null): void {
    this.dispatchEvent(new CustomEvent(name, { detail }));
  }

  #tick(now: number): void {
    const seconds = (now - this.#last) / 1000;
    this.#last = now;
    if (!this.paused && !this.ended) {
      this.#time += seconds * this.speed;
      if (this.#time >= this.duration) {
        this.ended = !this.loop;
        this.#time = this.loop ? 0 : this.duration;
        if (this.ended) this.#tell("ended");
      }
      this.#tell("time");
      this.#draw();
    }
    if (this.#first) {
      this.#first = false;
      this.#draw();
      this.#tell("firstpicture");
    }
    this.#request = requestAnimationFrame((next) => this.#tick(next));
  }

  #draw(): void {
    const { width, height } = this.canvas;
    const pen = this.canvas.getContext("2d");
    if (!pen || !this.#opened) return;
    this.#shown++;
    const sky = pen.createLinearGradient(0, 0, 0, height);
    sky.addColorStop(0, "#2b3440");
    sky.addColorStop(1, "#0e1116");
    pen.fillStyle = sky;
    pen.fillRect(0, 0, width, height);
    const balls = Array.from({ length: BALLS }, (_, i) => this.#ball(i)).filter((ball) => ball.z > 0.1);
    balls.sort((a, b) => b.z - a.z);
    for (const { x, y, z, hue } of balls) {
      const radius = (0.05 * height) / z;
      const shade = pen.createRadialGradient(x - radius / 3, y - radius / 3, 0, x, y, radius);
      shade.addColorStop(0, `hsl(${hue} 60% 78%)`);
      shade.addColorStop(1, `hsl(${hue} 55% 38%)`);
      pen.fillStyle = shade;
      pen.beginPath();
      pen.arc(x, y, radius, 0, 2 * Math.PI);
      pen.fill();
    }
  }

  /** A ball of a turning knot, in pixels and its depth. */
  #ball(i: number): { x: number; y: number; z: number; hue: number } {
    const { position, forward, up, fovY } = this.#camera;
    const a = (i / BALLS) * 2 * Math.PI;
    const turn = 2 * a + 0.4 * this.#time;
    const r = 1 + 0.35 * Math.cos(3 * a);
    const at = [r * Math.cos(turn), 0.5 * Math.sin(3 * a), r * Math.sin(turn)];
    const d = at.map((x, k) => x - position[k]);
    const right = [0, 1, 2].map((k) => forward[(k + 1) % 3] * up[(k + 2) % 3] - forward[(k + 2) % 3] * up[(k + 1) % 3]);
    const along = (b: readonly number[]) => d[0] * b[0] + d[1] * b[1] + d[2] * b[2];
    const { width, height } = this.canvas;
    const focal = height / 2 / Math.tan((fovY * Math.PI) / 360);
    const z = along(forward);
    return {
      x: width / 2 + (focal * along(right)) / z,
      y: height / 2 - (focal * along(up)) / z,
      z,
      hue: (360 * i) / BALLS,
    };
  }
}

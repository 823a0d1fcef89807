// How sharp the picture is: as many pixels as can be drawn in time while something moves, all of them when nothing does.
import type { PlayerLike } from "./desk.ts";

/** Sharper than this, nobody sees a difference. */
const MOST_RATIO = 2;
const LEAST = 0.35;
/** Intervals that are looked at together; fewer where that takes longer than so many milliseconds. */
const WINDOW = 12;
const FEWEST = 3;
const WINDOW_MS = 1500;
/** Milliseconds from one picture to the next: slower is too slow, faster leaves room. */
const SLOW_MS = 26;
const FAST_MS = 18.5;
/** A step down has helped if pictures come in this share of the time before it. */
const HELPED = 0.92;
/** Fast windows in a row before more pixels are tried; twice as many where they were too many, up to PATIENCE. */
const WAIT = 3;
const PATIENCE = 48;
/** A step down that is less than this cannot be told from chance. */
const JUDGED = 0.9;
/** Of the scale: a step up, and the largest step down. */
const UP = 1.2;
const DOWN = 0.6;

/** Chooses the share of pixels in each direction, 0.35 … 1, from what it is told of each picture. */
export class ScaleChooser {
  scale = 1;
  #intervals: number[] = [];
  /** The typical interval before the scale was lowered, and that scale: the step is judged by them. */
  #before: { ms: number; scale: number } | null = null;
  #fast = 0;
  #wait = WAIT;
  #tried = PATIENCE;
  #idle = 0;

  /** A time from one picture to the next. True: the scale has changed. */
  add(ms: number): boolean {
    const all = this.#intervals;
    all.push(ms);
    const enough = all.length >= FEWEST && all.reduce((sum, one) => sum + one) > WINDOW_MS;
    if (all.length < WINDOW && !enough) return false;
    const typical = all.sort((a, b) => a - b)[all.length >> 1];
    this.#intervals = [];
    const was = this.scale;
    this.#choose(typical);
    return this.scale !== was;
  }

  #choose(ms: number): void {
    const before = this.#before;
    this.#before = null;
    this.#fast = ms < FAST_MS ? this.#fast + 1 : 0;
    this.#tried++;
    if (before && ms > HELPED * before.ms) {
      this.scale = before.scale;
      this.#idle = PATIENCE;
    } else if (ms > SLOW_MS) {
      this.#lower(ms);
    } else if (this.#fast >= this.#wait && this.scale < 1) {
      this.scale = Math.min(1, this.scale * UP);
      this.#fast = 0;
      this.#tried = 0;
    }
  }

  #lower(ms: number): void {
    if (this.#idle > 0) this.#idle--;
    else if (this.scale > LEAST) {
      const was = this.scale;
      this.scale = Math.max(LEAST, was * Math.max(DOWN, Math.sqrt(FAST_MS / ms)));
      if (this.scale < JUDGED * was) this.#before = { ms, scale: was };
      this.#wait = this.#tried <= WAIT ? Math.min(PATIENCE, 2 * this.#wait) : WAIT;
    }
  }
}

/** Pixels of the pictures on an area of CSS pixels: whole ones, at least one. */
export function pictureSize(width: number, height: number, ratio: number, scale: number): [number, number] {
  const factor = Math.min(ratio, MOST_RATIO) * scale;
  return [Math.max(1, Math.round(width * factor)), Math.max(1, Math.round(height * factor))];
}

const SAMPLE_MS = 100;
/** Over so long a player counts the pictures that it draws: before, nobody can tell. */
const COUNTED_MS = 2000;
/** Of the pictures that were to be drawn: fewer are too few. */
const ENOUGH = 0.85;

/** Since when something goes on; 0: it does not. */
const since = (start: number, now: number, goesOn: boolean): number => (goesOn ? start || now : 0);

/** How quickly pictures come: animation frames, and the pictures that a player draws in them. */
class Pace {
  #start = 0;
  #frames = 0;
  /** Since when every animation frame has something new to draw, and since when it plays; 0: not now. */
  #moving = 0;
  #playing = 0;

  rest(): void {
    this.#start = 0;
    this.#moving = 0;
    this.#playing = 0;
  }

  /** An animation frame. Ten times a second, the milliseconds from one picture to the next; else null. */
  tick(now: number, moves: boolean, plays: boolean, player: PlayerLike): number | null {
    this.#moving = since(this.#moving, now, moves);
    this.#playing = since(this.#playing, now, plays);
    const counted = [this.#moving, this.#playing].map((start) => start > 0 && now - start > COUNTED_MS);
    if (!this.#start) {
      this.#start = now;
      this.#frames = 0;
    } else this.#frames++;
    const elapsed = now - this.#start;
    if (elapsed < SAMPLE_MS || this.#frames === 0) return null;
    const interval = elapsed / this.#frames;
    this.#start = now;
    this.#frames = 0;
    const { displayFps } = player.stats;
    if (!counted.includes(true) || displayFps <= 0) return null;
    const few = displayFps < ENOUGH * player.fps * player.speed;
    return counted[0] || few ? Math.max(interval, 1000 / displayFps) : interval;
  }
}

/** So long after the last motion, all pixels are drawn, however slowly. */
const SHARPEN_MS = 250;

export class Sharpness {
  readonly #chooser = new ScaleChooser();
  readonly #pace = new Pace();
  #still = false;
  #timer = 0;

  constructor(readonly changed: () => void) {}

  get scale(): number {
    return this.#still ? 1 : this.#chooser.scale;
  }

  /** An animation frame: whether another follows, the camera has moved, and time passes for the player. */
  tick(now: number, is: { goesOn: boolean; moved: boolean; plays: boolean }, player: PlayerLike): void {
    const { goesOn, moved, plays } = is;
    const ms = goesOn ? this.#pace.tick(now, moved, plays, player) : this.#pace.rest();
    if (ms && this.#chooser.add(ms)) {
      this.#pace.rest();
      this.changed();
    }
    this.#turn(!goesOn);
  }

  close(): void {
    window.clearTimeout(this.#timer);
  }

  #turn(still: boolean): void {
    window.clearTimeout(this.#timer);
    if (still === this.#still || this.#chooser.scale === 1) return;
    const change = () => {
      this.#still = still;
      this.changed();
    };
    if (still) this.#timer = window.setTimeout(change, SHARPEN_MS);
    else change();
  }
}

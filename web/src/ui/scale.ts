// How many of the display's pixels are drawn: fewer where pictures come too slowly, as many as fit where they do not.

/** Sharper than this, nobody sees a difference. */
const MOST_RATIO = 2;
const LEAST = 0.35;
/** What is looked at together, of that which is told; fewer where that takes longer than so many milliseconds. */
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
  /** Windows since more pixels were tried. */
  #tried = PATIENCE;
  /** Slow windows to sit out: pixels were not what was slow. */
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

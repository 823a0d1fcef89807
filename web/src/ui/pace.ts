// How quickly pictures come: animation frames, and the pictures that a player draws in them.
import type { PlayerLike } from "./player-like.ts";

const SAMPLE_MS = 100;
/** Over so long a player counts the pictures that it draws: before, nobody can tell. */
const COUNTED_MS = 2000;
/** Of the pictures that were to be drawn: fewer are too few. */
const ENOUGH = 0.85;

/** Since when something goes on; 0: it does not. */
const since = (start: number, now: number, goesOn: boolean): number => (goesOn ? start || now : 0);

export class Pace {
  #start = 0;
  #frames = 0;
  /** Since when every animation frame has something new to draw, and since when it plays; 0: not now. */
  #moving = 0;
  #playing = 0;

  /** What comes next has nothing to do with what was: other pictures, or animation frames after a rest. */
  rest(): void {
    this.#start = 0;
    this.#moving = 0;
    this.#playing = 0;
  }

  /**
   * An animation frame: whether it has something new to draw, and whether time passes for the player. Ten times a second,
   * the milliseconds from one picture to the next; else null.
   */
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

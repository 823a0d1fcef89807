// Screens and decoders that are too slow: where many frames of a level are dropped, levels with less to draw and to decode
// are offered, and finer ones are tried again later. As DroppedFramesRule of dash.js (375 frames, 15 %), but for a window
// of the last frames, and with a way back.
//
// A level has no more Gaussians than the one before it and no more rows that move, in every group: levels are the order
// in which less is to do, whatever their bytes are. Keyframe qualities make no difference to it.

export type Cause = "decoder" | "display";

/** Frames and seconds of play that are looked at together: the element first tries fewer pixels, every 4 s at most. */
const FEWEST = 60;
const WINDOW_S = 5;
/** Shares of dropped frames: with more, it is too slow; with no more, all is well. */
const MANY = 0.15;
const FEW = 0.03;
/** Of a longer gap, such as the sleep of a computer, so many seconds count. */
const LONGEST_S = 0.5;
const MOST_FPS = 60;
/** All is well for so long before a finer level is tried; twice as long after each one that was too much. */
const PATIENCE_S = 30;
const MOST_PATIENCE_S = 480;

/** A frame that was drawn: its level, frames a second as they are played, and those dropped since the one before. */
export interface Drawn {
  level: number;
  rate: number;
  dropped: Readonly<Record<Cause, number>>;
}

/** Chooses the finest level that is offered, from what it is told of each frame. */
export class DropRule {
  /** The finest level that may be played, and what was too slow for the one before; null: all may be. */
  finest = 0;
  cause: Cause | null = null;
  #level = -1;
  #drawn = 0;
  #dropped = { decoder: 0, display: 0 };
  #wellS = 0;
  #patienceS = PATIENCE_S;
  /** A finer level was allowed, and has not been well for as long as it was waited for. */
  #onTrial = false;

  /** `tiers`: how many keyframe tiers each level shows. */
  constructor(private readonly tiers: readonly number[]) {}

  restart(): void {
    this.#level = -1;
  }

  /** True: another level is the finest. */
  add({ level, rate, dropped }: Drawn): boolean {
    if (level < this.finest) return false; // it was on its way to the screen
    if (level !== this.#level) this.#begin(level);
    this.#drawn++;
    for (const cause of ["decoder", "display"] as const) {
      this.#dropped[cause] += Math.min(dropped[cause], LONGEST_S * rate);
    }
    const { decoder, display } = this.#dropped;
    const frames = this.#drawn + decoder + display;
    if (frames < FEWEST || frames < WINDOW_S * rate) return false;
    const share = 1 - this.#drawn / (frames * Math.min(1, MOST_FPS / rate));
    this.#begin(level);
    if (share > MANY) return this.#lower(level, decoder > display ? "decoder" : "display");
    const says = !this.#onTrial || level === this.finest; // a coarser level is no trial of this one
    this.#wellS = share > FEW ? 0 : this.#wellS + (says ? frames / rate : 0);
    return this.#wellS >= this.#patienceS && this.#raise();
  }

  #begin(level: number): void {
    this.#level = level;
    this.#drawn = 0;
    this.#dropped = { decoder: 0, display: 0 };
  }

  /** From a level to the next; where drawing is slow, to the next with fewer Gaussians, if there is one. */
  #lower(level: number, cause: Cause): boolean {
    this.#wellS = 0;
    if (this.#onTrial) this.#patienceS = Math.min(MOST_PATIENCE_S, 2 * this.#patienceS);
    this.#onTrial = false;
    const fewer = this.tiers.findIndex((count) => count < this.tiers[level]);
    const next = cause === "display" && fewer > 0 ? fewer : level + 1;
    if (next >= this.tiers.length) return false;
    this.finest = next;
    this.cause = cause;
    return true;
  }

  #raise(): boolean {
    this.#wellS = 0;
    if (this.#onTrial) this.#patienceS = PATIENCE_S;
    this.#onTrial = this.finest > 0;
    if (!this.#onTrial) return false;
    this.finest--;
    if (!this.finest) this.cause = null;
    return true;
  }
}

// How sharp the picture is: as many pixels as can be drawn in time while something moves, and all of them when nothing does.
import { Pace } from "./pace.ts";
import type { PlayerLike } from "./player-like.ts";
import { ScaleChooser } from "./scale.ts";

/** So long after the last motion, all pixels are drawn, however slowly. */
const SHARPEN_MS = 250;

/** What goes on in an animation frame. */
export interface Motion {
  /** Another frame follows. */
  readonly goesOn: boolean;
  /** The camera has moved. */
  readonly moved: boolean;
  /** Time passes for the player, which has what it needs. */
  readonly plays: boolean;
}

export class Sharpness {
  readonly #chooser = new ScaleChooser();
  readonly #pace = new Pace();
  #still = false;
  #timer = 0;

  /** `changed` is called when there is another scale. */
  constructor(readonly changed: () => void) {}

  /** The share of the display's pixels in each direction that is to be drawn. */
  get scale(): number {
    return this.#still ? 1 : this.#chooser.scale;
  }

  /** An animation frame. */
  tick(now: number, { goesOn, moved, plays }: Motion, player: PlayerLike): void {
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

  /** Nothing moves, or something does again. */
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

// A segment between its files and the screen.
import type { Atlas, Canonical, StateFrame } from "../format/types.ts";

/** A tile of a segment that is decoded, or about to be. */
export interface Layer {
  readonly tile: number;
  readonly level: number;
  readonly canonical: Canonical;
  /** Of its pictures; of a segment that has none, it is not used. */
  readonly atlas: Atlas;
  /** One a frame: undefined is not decoded yet, null shows the canonical space. */
  readonly frames: (StateFrame | null | undefined)[];
  /** It came when decoding had begun, so that nobody waits for it. */
  readonly late: boolean;
  /** Its frame that was shown last; −1: none. */
  shown: number;
}

/** A segment that is decoded, or about to be, with the tiles that are there. */
export interface Clip {
  /** In the session. */
  readonly position: number;
  /** Number of the rung whose files it is made of, late ones aside. */
  readonly rung: number;
  /** Of tiles with rows. */
  readonly layers: Layer[];
  /** The frame that was shown last; −1: none. */
  shown: number;
}

/** Whether a frame of a clip can be shown: all tiles that came in time are decoded. */
export const isDecoded = ({ layers }: Clip, frame: number): boolean =>
  layers.every(({ late, frames }) => late || frames[frame] !== undefined);

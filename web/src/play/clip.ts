// A segment between its files and the screen.
import type { Atlas, Canonical, StateFrame } from "../format/types.ts";

/** A segment that is decoded, or about to be. */
export interface Clip {
  /** In the session. */
  readonly position: number;
  /** Number of the rung whose files it is made of. */
  readonly rung: number;
  readonly quality: number;
  readonly level: number;
  readonly canonical: Canonical;
  /** Of its pictures; of a segment that has none, it is not used. */
  readonly atlas: Atlas;
  /** One a frame: undefined is not decoded yet, null shows the canonical space. */
  readonly frames: (StateFrame | null | undefined)[];
}

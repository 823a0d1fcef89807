// What page and worker say to each other.
import type { Canonical, StateFrame } from "../format/types.ts";
import type { Batch } from "./batch.ts";
import type { WireError } from "./errors.ts";

/** The canonical space of a tile by what it is made of. */
export interface CanonicalName {
  /** Counted from 0. */
  group: number;
  /** Counted from 0. */
  tile: number;
  quality: number;
  /** How many tiers of the tile, from the first on. */
  tiers: number;
}

/** A batch as a message. */
export interface WireBatch extends Omit<Batch, "refused"> {
  refused: [string, WireError][];
  /** Path and bytes of the tables among the files. */
  tables: [string, Uint8Array][];
}

export interface Opened {
  luma: "exact" | "invertible";
  batch: WireBatch;
}

/** What the page can ask for: arguments, what comes on the way, and the answer. */
export interface Calls {
  open: { args: { url: string; aheadBytes: number; attempts: number }; event: never; value: Opened };
  fetch: { args: { paths: string[]; attempts: number }; event: number; value: WireBatch };
  refreshRoot: { args: { attempts: number }; event: never; value: WireBatch };
  canonical: { args: CanonicalName; event: never; value: Canonical };
  segment: {
    args: { index: number; level: number; of: CanonicalName };
    event: { t: number; frame: StateFrame | null };
    value: number;
  };
}
export type Call = keyof Calls;

/** What the page says without expecting an answer. */
export interface Note {
  /** Call that is given up, also when its answer is there. */
  cancel?: number;
  /** Frame `t` of a call of `segment` was shown. */
  taken?: { id: number; t: number };
}

export interface Request<K extends Call = Call> {
  id: number;
  call: K;
  args: Calls[K]["args"];
}

export type Reply =
  | { id: number; value: Calls[Call]["value"] }
  | { id: number; error: WireError }
  | { id: number; event: Calls[Call]["event"] };

/** The buffers of a message, to be handed over and not copied. */
export function buffersOf(value: unknown, found = new Set<ArrayBuffer>()): Set<ArrayBuffer> {
  if (ArrayBuffer.isView(value)) found.add(value.buffer as ArrayBuffer);
  else if (typeof value === "object" && value) for (const part of Object.values(value)) buffersOf(part, found);
  return found;
}

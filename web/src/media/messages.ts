// What page and worker say to each other.
import type { Canonical, CanonicalName, DeltaFrame } from "../format/types.ts";
import type { Batch } from "./batch.ts";
import type { WireError } from "./errors.ts";

export interface WireBatch extends Omit<Batch, "refused"> {
  refused: [string, WireError][];
  tables: [string, Uint8Array][];
}

/** The poster of a package, and the seconds from asking for it to its last byte. */
export interface Poster {
  poster: Uint8Array;
  seconds: number;
}

/** What the page can ask for: arguments, what comes on the way, and the answer. */
export interface Calls {
  open: {
    args: { url: string; aheadBytes: number; keptBytes: number; attempts: number };
    event: Poster;
    value: { luma: "exact" | "invertible"; batch: WireBatch };
  };
  fetch: { args: { paths: string[]; attempts: number }; event: { bytes: number; expected: number }; value: WireBatch };
  refreshRoot: { args: { attempts: number }; event: never; value: WireBatch };
  sound: { args: { group: number }; event: never; value: Uint8Array };
  canonical: { args: CanonicalName; event: never; value: Canonical };
  segment: {
    args: { index: number; level: number; of: CanonicalName; first?: number };
    event: { t: number; frame: DeltaFrame | null };
    value: number;
  };
}
export type Call = keyof Calls;

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

/** `passing`: what was wrong with an answer, of whatever call, before it is asked for again. */
export type Reply =
  | { passing: string }
  | { id: number; value: Calls[Call]["value"] }
  | { id: number; error: WireError }
  | { id: number; event: Calls[Call]["event"] };

/** The buffers of a message, to be handed over and not copied. */
export function buffersOf(value: unknown, found = new Set<ArrayBuffer>()): Set<ArrayBuffer> {
  if (ArrayBuffer.isView(value)) found.add(value.buffer as ArrayBuffer);
  else if (typeof value === "object" && value) for (const part of Object.values(value)) buffersOf(part, found);
  return found;
}

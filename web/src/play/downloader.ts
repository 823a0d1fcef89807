// Where batches come from: the seam between a session and a link, simulated or real.
import type { Arrival, Request } from "./events.ts";
import type { Playout } from "./playout.ts";

/** A download under way. */
export interface Partial {
  atS: number;
  /** Since its first byte. */
  elapsedS: number;
  /** So far, headers included. */
  bytes: number;
  expectedBytes: number;
}

/** Whether a download is to be abandoned. */
export type GiveUp = (partial: Partial) => boolean;

/** Fetches one batch after another. It alone knows time and bytes. */
export interface Downloader {
  /** Seconds from a request to its first byte on an idle link. */
  readonly rttS: number;
  /** Whether a request may be sent before the batch before it has arrived. */
  readonly pipelines: boolean;
  /** Seconds of a clock that never goes back. */
  now(): number;
  /** Wait until a moment; less long where the playout changes, or the signal aborts. Infinity: for that alone. */
  wait(untilS: number, playout: Playout, signal: AbortSignal): Promise<void>;
  /** Request a batch and wait for it. `giveUp` is asked every CHECK_S whether to abandon it; when the signal aborts, it
   * is abandoned at once. Files that are whole by then are kept. Rejects with TransportError when the link fails. */
  fetch(request: Request, giveUp: GiveUp | null, signal: AbortSignal): Promise<Arrival>;
}

// What happens in a session, as values: requests, arrivals, the events that a session yields; and the seam between a
// session and a link, simulated or real.
//
// Times are seconds of the downloader's clock.
import type { FormatError } from "../format/errors.ts";
import { type Batch, filesOf } from "./offers.ts";
import type { Playout } from "./playout.ts";

/** What a batch was requested for: tables (airgs.json, pages of the index, tables of groups); the next segment with
 * keys of its group; the next segment, whose keys are decoded; a better rung of a buffered segment.
 */
export type BatchKind = "tables" | "group" | "state" | "replacement";

export interface Request {
  kind: BatchKind;
  /** Of the segment in the session. */
  position: number;
  rung: number;
  batch: Batch;
  /** No earlier than this. */
  sentS: number;
  /** From then, or from the end of the batch before if that is later, to the first byte. */
  latencyS: number;
}

export interface Arrival {
  request: Request;
  firstByteS: number;
  /** Of the last byte, or of giving up. */
  atS: number;
  /** That passed, headers included. */
  bytes: number;
  /** Files that came whole and are what the tables say, in order. */
  whole: readonly string[];
  /** Files that came and cannot be used. */
  refused: ReadonlyMap<string, FormatError>;
  abandoned: boolean;
  /** It came from a cache and tells nothing of the link. */
  cached: boolean;
}

/** Whether every file of a batch can be used. */
export const isComplete = (arrival: Arrival): boolean => arrival.whole.length === filesOf(arrival.request.batch).length;

/** The files that are of use: a state segment whose batch is not complete is dropped. */
export const usableFiles = (arrival: Arrival): readonly string[] =>
  isComplete(arrival) ? arrival.whole : arrival.whole.filter((path) => !arrival.request.batch.state.includes(path));

export interface Partial {
  atS: number;
  /** Since its first byte. */
  elapsedS: number;
  bytes: number;
  expectedBytes: number;
}

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
   * is abandoned at once. Files that are whole by then count. Rejects with TransportError when the link fails.
   */
  fetch(request: Request, giveUp: GiveUp | null, signal: AbortSignal): Promise<Arrival>;
}

export interface Arrived {
  type: "arrived";
  arrival: Arrival;
  /** The estimate when the batch was requested. */
  throughputBps: number;
}

/** A replacement took the place of a buffered segment; `before` and `after` are rungs. */
export interface Replaced {
  type: "replaced";
  position: number;
  before: number;
  after: number;
}

/** No rung of a segment can be had. */
export interface Lost {
  type: "lost";
  position: number;
  atS: number;
}

/** A session ends before its package says so. */
export interface Cut {
  type: "cut";
  atS: number;
  why: string;
}

/** A segment's final time on the screen; rung null: it was lost, the last picture stands. */
export interface Shown {
  type: "shown";
  position: number;
  segment: number;
  loop: number;
  rung: number | null;
  /** When it had arrived and was decoded. */
  readyS: number;
  /** When its first frame is shown, as the schedule stands. */
  startS: number;
  frames: number;
  /** Waited for it on the screen. */
  stallS: number;
  /** dB; null: lost or not measured. */
  psnr: number | null;
}

export type SessionEvent = Arrived | Replaced | Lost | Cut | Shown;

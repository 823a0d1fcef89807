// What happens in a session, as values: requests, arrivals, the events that a session yields; and the seam between a
// session and a link, simulated or real.
//
// Times are seconds of the downloader's clock.
import { FormatError } from "../format/errors.ts";
import { CHECK_S, ROOT_PATH } from "../generated/constants.ts";
import { following, waitFor } from "../media/bell.ts";
import type { Fetched, Media } from "../media/client.ts";
import { type Batch, filesOf, type Offers } from "./offers.ts";
import type { Playout } from "./playout.ts";

export interface Request {
  /** Requested were tables (airgs.json, pages of the index, tables of groups); the next segment with keyframes of its group;
   * the next segment, whose keyframes are decoded; a better rung of a buffered segment.
   */
  kind: "tables" | "group" | "delta" | "replacement";
  position: number;
  rung: number;
  batch: Batch;
  sentS: number;
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
  refused: ReadonlyMap<string, FormatError>;
  abandoned: boolean;
  /** It came from a cache and tells nothing of the link. */
  cached: boolean;
}

export const isComplete = (arrival: Arrival): boolean => arrival.whole.length === filesOf(arrival.request.batch).length;

/** The files that are of use: a delta segment whose batch is not complete is dropped. */
export const usableFiles = (arrival: Arrival): readonly string[] =>
  isComplete(arrival) ? arrival.whole : arrival.whole.filter((path) => !arrival.request.batch.delta.includes(path));

export interface Partial {
  atS: number;
  elapsedS: number;
  bytes: number;
  expectedBytes: number;
}

export type GiveUp = (partial: Partial) => boolean;

/** Fetches one batch after another. It alone knows time and bytes. */
export interface Downloader {
  /** Seconds from a request to its first byte on an idle link. */
  readonly rttS: number;
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
  stallS: number;
  /** dB; null: lost or not measured. */
  psnr: number | null;
}

export type SessionEvent =
  | Arrived
  | Shown
  /** A replacement took the place of a buffered segment; `before` and `after` are rungs. */
  | { type: "replaced"; position: number; before: number; after: number }
  /** No rung of a segment can be had. */
  | { type: "lost"; position: number; atS: number }
  /** The session ends before its package says so. */
  | { type: "cut"; atS: number; why: string };

const LONGEST_MS = 2 ** 31 - 1; // of timers of browsers

/** What a downloader needs of an open package. Where a fetch is given up, the files that are whole count. */
export type Source = Pick<Media, "opened" | "fetch" | "refreshRoot">;

export class HttpDownloader implements Downloader {
  private shortestS = Infinity;
  private opened: Fetched | null;

  constructor(private readonly source: Source) {
    this.opened = source.opened;
  }

  /** The shortest wait for a first byte so far, in seconds; 0 before there is any. */
  get rttS(): number {
    return this.shortestS < Infinity ? this.shortestS : 0;
  }

  now(): number {
    return performance.now() / 1000;
  }

  wait(untilS: number, playout: Playout, signal: AbortSignal): Promise<void> {
    const leftMs = Math.min(1000 * (untilS - this.now()), LONGEST_MS);
    return leftMs > 0 ? waitFor(leftMs, signal, (end) => playout.onChange(end)) : Promise.resolve();
  }

  /** Answers the first request for airgs.json with what came when the package was opened. */
  async fetch(request: Request, giveUp: GiveUp | null, signal: AbortSignal): Promise<Arrival> {
    const paths = filesOf(request.batch);
    if (paths[0] !== ROOT_PATH) return this.batch(request, paths, giveUp, signal);
    const came = this.opened ?? (await this.root(signal));
    this.opened = null;
    return arrival(request, came, false);
  }

  private async root(signal: AbortSignal): Promise<Fetched> {
    try {
      return await this.source.refreshRoot({ signal });
    } catch (error) {
      if (!(error instanceof FormatError)) throw error;
      const nowS = this.now();
      const refused = new Map([[ROOT_PATH, error]]);
      return { firstByteS: nowS, endS: nowS, bytes: 0, cached: true, whole: [], refused };
    }
  }

  /** Looks at a download every CHECK_S from its first byte on, and ends it where it is given up. */
  private async batch(request: Request, paths: string[], giveUp: GiveUp | null, signal: AbortSignal): Promise<Arrival> {
    const sentS = this.now();
    const ending = following(signal);
    let timer: ReturnType<typeof setInterval> | undefined;
    let bytes = 0;
    let expectedBytes = 0;
    const onProgress = (come: number, expected: number) => {
      [bytes, expectedBytes] = [come, expected];
      const firstS = this.now();
      const look = (atS: number) => giveUp?.({ atS, elapsedS: atS - firstS, bytes, expectedBytes }) && ending.abort();
      if (giveUp) timer ??= setInterval(() => look(this.now()), 1000 * CHECK_S);
    };
    try {
      const came = await this.source.fetch(paths, { signal: ending.signal, onProgress });
      if (!came.cached && came.bytes > 0) this.shortestS = Math.min(this.shortestS, came.firstByteS - sentS);
      return arrival(request, came, came.whole.length + came.refused.size < paths.length);
    } finally {
      clearInterval(timer);
      ending.abort();
    }
  }
}

function arrival(request: Request, came: Fetched, abandoned: boolean): Arrival {
  const whole = filesOf(request.batch).filter((path) => came.whole.includes(path));
  const { firstByteS, endS: atS, refused, cached } = came;
  return { request, firstByteS, atS, bytes: Math.max(1, came.bytes), whole, refused, abandoned, cached };
}

/** Let a session over a growing package begin with its newest group, whose place pages may have to tell. */
export async function joinNewest(offers: Offers, source: Source): Promise<void> {
  if (!offers.live) return;
  const { index } = offers.tables;
  for (const path of index.pagesTo("segments", index.segments - 1)) {
    if (index.hasPage(path)) continue;
    const { refused } = await source.fetch([path]);
    for (const error of refused.values()) throw error;
  }
  offers.first = index.entry(index.groups - 1).firstSegment;
}

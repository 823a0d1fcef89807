// Batches over a real connection, by the clock of the page: the other Downloader is a simulated link of the tests.
import { FormatError } from "../format/errors.ts";
import { CHECK_S, ROOT_PATH } from "../generated/constants.ts";
import { waitFor } from "../media/bell.ts";
import type { Fetched, Media } from "../media/client.ts";
import type { Arrival, Downloader, GiveUp, Request } from "./downloader.ts";
import { filesOf, type Offers } from "./offers.ts";
import type { Playout } from "./playout.ts";

/** Timers of browsers take no more, milliseconds. */
const LONGEST_MS = 2 ** 31 - 1;

/** What a downloader needs of an open package. Where a fetch is given up, the files that are whole count. */
export type Source = Pick<Media, "opened" | "fetch" | "refreshRoot">;

/** Fetches from a server; time is that of `performance.now()`, in seconds. */
export class HttpDownloader implements Downloader {
  /** Batches follow each other: one is known to be over only when it is. */
  readonly pipelines = false;
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
      return { firstByteS: nowS, endS: nowS, bytes: 0, cached: true, whole: [], refused, retries: [] };
    }
  }

  /** Looks at a download every CHECK_S from its first byte on, and ends it where it is given up. */
  private async batch(request: Request, paths: string[], giveUp: GiveUp | null, signal: AbortSignal): Promise<Arrival> {
    const sentS = this.now();
    const ending = new AbortController();
    const end = () => ending.abort();
    signal.addEventListener("abort", end);
    if (signal.aborted) end();
    let timer: ReturnType<typeof setInterval> | undefined;
    let bytes = 0;
    let expectedBytes = 0;
    const onProgress = (come: number, expected: number) => {
      [bytes, expectedBytes] = [come, expected];
      const firstS = this.now();
      const look = (atS: number) => giveUp?.({ atS, elapsedS: atS - firstS, bytes, expectedBytes }) && end();
      if (giveUp) timer ??= setInterval(() => look(this.now()), 1000 * CHECK_S);
    };
    try {
      const came = await this.source.fetch(paths, { signal: ending.signal, onProgress });
      if (!came.cached && came.bytes > 0) this.shortestS = Math.min(this.shortestS, came.firstByteS - sentS);
      return arrival(request, came, came.whole.length + came.refused.size < paths.length);
    } finally {
      clearInterval(timer);
      signal.removeEventListener("abort", end);
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

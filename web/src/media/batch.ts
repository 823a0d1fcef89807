// The files of a batch, all at once, and what came of them when.
import type { FormatError } from "../format/errors.ts";
import { pause } from "./bell.ts";
import type { Ask, FileClient } from "./http.ts";

const TIMINGS = 2000; // entries of the browser's list of what was loaded
const LOOKS = 6; // for the entry of a file: the browser writes it down a moment after the last byte
const LOOK_MS = 2;

/** What became of a batch. Times are milliseconds since the Unix epoch, by a clock that only goes forward. */
export interface Batch {
  firstByteMs: number;
  endMs: number;
  /** Over the network, headers included. */
  bytes: number;
  /** Nothing came over the network: all of it was kept or cached. */
  cached: boolean;
  /** Files that came and are what the tables say. */
  whole: string[];
  /** Files that cannot be had, and why. Those that were given up are neither. */
  refused: Map<string, FormatError>;
}

export type FileAsk = Pick<Ask, "path" | "limit" | "attempts" | "patient" | "changing" | "accept">;

const nowMs = () => performance.timeOrigin + performance.now();

let underWay = 0; // batches of this thread

/** Fetches files at once; those that a signal stops are neither whole nor refused. `onProgress` hears how many bytes
 * have come so far. Throws TransportError.
 */
export async function fetchBatch(
  client: FileClient,
  asks: FileAsk[],
  signal: AbortSignal,
  onProgress: (bytes: number) => void = () => {},
): Promise<Batch> {
  const files = asks.map(() => ({ url: "", askedMs: 0, bytes: 0 }));
  const batch = { whole: [] as string[], refused: new Map<string, FormatError>() };
  let firstByteMs: number | null = null;
  let total = 0;
  const get = async (ask: FileAsk, file: (typeof files)[number]) => {
    const refused = await client.get({
      ...ask,
      signal,
      accept: async (bytes, headers) => {
        await ask.accept(bytes, headers);
        batch.whole.push(ask.path);
      },
      onAsk: (url) => Object.assign(file, { url, askedMs: performance.now() }),
      onBytes: (bytes) => {
        firstByteMs ??= nowMs();
        file.bytes += bytes;
        total += bytes;
        onProgress(total);
      },
    });
    if (refused) batch.refused.set(ask.path, refused);
  };
  performance.setResourceTimingBufferSize(TIMINGS);
  underWay++;
  try {
    await Promise.all(asks.map((ask, i) => get(ask, files[i])));
    const endMs = nowMs();
    const cached = await Promise.all(files.map(({ url, askedMs }) => fromCache(url, askedMs)));
    const bytes = files.reduce((sum, file, i) => sum + (cached[i] ? 0 : file.bytes), 0);
    return { ...batch, firstByteMs: firstByteMs ?? endMs, endMs, bytes, cached: cached.every(Boolean) };
  } finally {
    if (--underWay === 0) performance.clearResourceTimings();
  }
}

/** Whether an answer was cached, so that its time says nothing of the network. Nobody knows of other sites that do not
 * let pages see times: all of them are 0.
 */
async function fromCache(url: string, askedMs: number): Promise<boolean> {
  type Entry = PerformanceResourceTiming & { deliveryType?: string };
  for (let look = 0; look < LOOKS; look++) {
    const entries = performance.getEntriesByName(url, "resource") as Entry[];
    const entry = entries.filter(({ startTime }) => startTime >= askedMs - 1).at(-1); // browsers coarsen times to 1 ms
    if (entry?.deliveryType === "cache") return true;
    if (entry) return entry.transferSize === 0 && entry.decodedBodySize > 0 && entry.responseStart > 0;
    await pause(LOOK_MS);
  }
  return false;
}

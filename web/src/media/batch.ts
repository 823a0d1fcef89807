// The files of a batch, all at once, and what came of them when.
import type { FormatError } from "../format/errors.ts";
import { pause } from "./bell.ts";
import type { Ask, FileClient, Retry } from "./http.ts";

const TIMINGS = 2000; // entries of the browser's list of what was loaded
const LOOKS = 6; // for the entry of a file: the browser writes it down a moment after the last byte
const LOOK_MS = 2;

/** What became of a batch. Times are milliseconds since the Unix epoch, by a clock that only goes forward. */
export interface Batch {
  firstByteMs: number;
  endMs: number;
  /** Over the network, headers included. */
  bytes: number;
  /** Nothing came over the network: all of it was cached. */
  cached: boolean;
  whole: string[];
  refused: Map<string, FormatError>;
  retries: Retry[];
}

/** How a file of a batch is asked for. */
export type FileAsk = Pick<Ask, "path" | "limit" | "attempts" | "patient" | "changing" | "accept">;

/** A file under way. */
interface File {
  path: string;
  url: string;
  askedMs: number;
  bytes: number;
}

const nowMs = () => performance.timeOrigin + performance.now();

let underWay = 0; // batches of this thread

/** Fetches files at once; files that a signal stops are neither whole nor refused.
 *
 * `onProgress` is told how many bytes have come so far. Throws TransportError.
 */
export async function fetchBatch(
  client: FileClient,
  asks: FileAsk[],
  signal: AbortSignal,
  onProgress: (bytes: number) => void,
): Promise<Batch> {
  const run = new Run(onProgress);
  performance.setResourceTimingBufferSize(TIMINGS);
  underWay++;
  try {
    await Promise.all(asks.map((ask) => run.get(client, ask, signal)));
    return await run.result();
  } finally {
    if (--underWay === 0) performance.clearResourceTimings();
  }
}

class Run {
  readonly #files: File[] = [];
  readonly #whole: string[] = [];
  readonly #refused = new Map<string, FormatError>();
  readonly #retries: Retry[] = [];
  #firstByteMs: number | null = null;
  #bytes = 0;

  constructor(readonly onProgress: (bytes: number) => void) {}

  async get(client: FileClient, ask: FileAsk, signal: AbortSignal): Promise<void> {
    const file: File = { path: ask.path, url: "", askedMs: 0, bytes: 0 };
    this.#files.push(file);
    const refused = await client.get({
      ...ask,
      signal,
      accept: async (bytes, headers) => {
        await ask.accept(bytes, headers);
        this.#whole.push(ask.path);
      },
      onAsk: (url) => Object.assign(file, { url, askedMs: performance.now() }),
      onBytes: (bytes) => this.#count(file, bytes),
      onRetry: (retry) => this.#retries.push(retry),
    });
    if (refused) this.#refused.set(ask.path, refused);
  }

  async result(): Promise<Batch> {
    const endMs = nowMs();
    const cached = await Promise.all(this.#files.map(({ url, askedMs }) => fromCache(url, askedMs)));
    const bytes = this.#files.reduce((sum, file, i) => sum + (cached[i] ? 0 : file.bytes), 0);
    return {
      firstByteMs: this.#firstByteMs ?? endMs,
      endMs,
      bytes,
      cached: cached.length > 0 && cached.every(Boolean),
      whole: this.#whole,
      refused: this.#refused,
      retries: this.#retries,
    };
  }

  #count(file: File, bytes: number): void {
    this.#firstByteMs ??= nowMs();
    file.bytes += bytes;
    this.#bytes += bytes;
    this.onProgress(this.#bytes);
  }
}

/** Whether an answer was cached, so that its time says nothing of the network. */
async function fromCache(url: string, askedMs: number): Promise<boolean> {
  for (let look = 0; look < LOOKS; look++) {
    const entries = performance.getEntriesByName(url, "resource") as PerformanceResourceTiming[];
    const entry = entries.filter(({ startTime }) => startTime >= askedMs - 1).at(-1); // browsers coarsen times to 1 ms
    if (entry) return isCached(entry);
    await pause(LOOK_MS);
  }
  return false;
}

/** Other sites that do not let pages see times give 0 for all of them: then nothing is known. */
function isCached(entry: PerformanceResourceTiming & { deliveryType?: string }): boolean {
  if (entry.deliveryType === "cache") return true;
  return entry.transferSize === 0 && entry.decodedBodySize > 0 && entry.responseStart > 0;
}

/** Files that were fetched and not used yet; those used least lately go first when there are too many. */
export class ByteStore {
  readonly #files = new Map<string, Uint8Array>();
  #bytes = 0;

  constructor(readonly limit: number) {}

  get bytes(): number {
    return this.#bytes;
  }

  put(path: string, bytes: Uint8Array): void {
    this.drop(path);
    this.#files.set(path, bytes);
    this.#bytes += bytes.length;
    for (const oldest of this.#files.keys()) {
      if (this.#bytes <= this.limit || oldest === path) break;
      this.drop(oldest);
    }
  }

  get(path: string): Uint8Array | undefined {
    const bytes = this.#files.get(path);
    if (!bytes) return undefined;
    this.#files.delete(path); // the order of a Map is that of adding: the last used is the last
    this.#files.set(path, bytes);
    return bytes;
  }

  drop(path: string): void {
    this.#bytes -= this.#files.get(path)?.length ?? 0;
    this.#files.delete(path);
  }
}

// A package on the web, as the page sees it: the worker fetches, checks and decodes.
import { start } from "worker:./worker.ts";
import type { FormatError } from "../format/errors.ts";
import { MissingTableError } from "../format/index.ts";
import { Tables } from "../format/package.ts";
import type { Canonical, CanonicalName, DeltaFrame } from "../format/types.ts";
import { ATTEMPTS, ROOT_PATH } from "../generated/constants.ts";
import type { Batch } from "./batch.ts";
import { aborted, fromWire, UnsupportedError } from "./errors.ts";
import type { Call, Calls, Note, Poster, Reply, Request, WireBatch } from "./messages.ts";
import { checkBrowser } from "./probe.ts";

export { TransportError, UnsupportedError } from "./errors.ts";

const AHEAD_BYTES = 48 * 2 ** 20;
const KEPT_BYTES = 64 * 2 ** 20;

/** What came of a batch. Times are seconds of performance.now() of the page. */
export interface Fetched extends Omit<Batch, "firstByteMs" | "endMs"> {
  /** When the first answer began; `endS` where none did. */
  firstByteS: number;
  endS: number;
}

export interface FetchOptions {
  /** Gives up: what is whole by then counts, and the promise resolves. */
  signal?: AbortSignal | undefined;
  /** So many bytes came, of so many that are to come over the network, headers included. */
  onProgress?: (bytes: number, expected: number) => void;
  /** Faulty answers after which a file cannot be had. */
  attempts?: number;
}

export interface OpenOptions {
  aheadBytes?: number;
  keptBytes?: number;
  attempts?: number;
  onPoster?: (poster: Blob) => void;
  /** Hears what is wrong with an answer before it is asked for again, as long as the package is open. */
  onPassing?: (words: string) => void;
}

/** An open package. Groups, segments, levels and qualities count from 0. */
export class Media {
  readonly #caller: Caller;
  readonly #frames = new WeakMap<DeltaFrame, { id: number; t: number }>();

  private constructor(
    caller: Caller,
    readonly tables: Tables,
    /** How this browser gives luma: as it was coded, or so that it can be undone. */
    readonly luma: "exact" | "invertible",
    readonly opened: Fetched,
    /** Bytes and seconds of the poster, the wait for its first byte included; null: there was none. */
    readonly first: { bytes: number; seconds: number } | null,
  ) {
    this.#caller = caller;
  }

  /** Opens the package in a folder, or whose airgs.json or manifest.mpd is at `url`, relative to the page.
   *
   * Throws FormatError, TransportError where there is no server, UnsupportedError where this browser cannot play it.
   */
  static async open(url: string, options: OpenOptions = {}): Promise<Media> {
    const { aheadBytes = AHEAD_BYTES, keptBytes = KEPT_BYTES, attempts = ATTEMPTS, onPoster, onPassing } = options;
    let first: Media["first"] = null;
    checkBrowser();
    const caller = new Caller(start, onPassing);
    try {
      const onEvent = ({ poster, seconds }: Poster) => {
        first = { bytes: poster.length, seconds };
        onPoster?.(new Blob([poster as BlobPart], { type: "image/jpeg" }));
      };
      const args = { url: folder(url), aheadBytes, keptBytes, attempts };
      const { luma, batch } = await caller.call("open", args, { onEvent });
      const [[, bytes]] = batch.tables;
      return new Media(caller, Tables.parse(bytes), luma, fetched(batch), first);
    } catch (error) {
      caller.end();
      throw error;
    }
  }

  /** Fetches files at once. Tables among them are added to `tables`; of the others the last used are kept. */
  async fetch(paths: string[], options: FetchOptions = {}): Promise<Fetched> {
    const { signal, onProgress, attempts = ATTEMPTS } = options;
    const batch = await this.#caller.call(
      "fetch",
      { paths, attempts },
      { signal, onEvent: ({ bytes, expected }) => onProgress?.(bytes, expected) },
    );
    for (const [path, bytes] of batch.tables) await this.tables.add(path, bytes);
    return fetched(batch);
  }

  /** The segment that shows a frame; fetches the tables to it. Throws FormatError, TransportError. */
  async locate(frame: number, signal: AbortSignal): Promise<number> {
    for (;;) {
      try {
        this.tables.keyframesOf(this.tables.index.groupAt("frames", frame), 0, 1); // asks for that of the base, too
        return this.tables.segmentAt(frame);
      } catch (error) {
        if (!(error instanceof MissingTableError)) throw error;
        const { refused } = await this.fetch([error.path], { signal });
        signal.throwIfAborted();
        for (const refusal of refused.values()) throw refusal;
      }
    }
  }

  /** Reads airgs.json again, which a growing package has changed; `tables` grow. */
  async refreshRoot({ signal, attempts = ATTEMPTS }: FetchOptions = {}): Promise<Fetched> {
    const batch = await this.#caller.call("refreshRoot", { attempts }, { signal });
    for (const [path, bytes] of batch.tables) if (path === ROOT_PATH) this.tables.grow(bytes);
    return fetched(batch);
  }

  /** The file with the sound of a group, which has some; where it is not at hand it is fetched. Throws FormatError. */
  sound(group: number, signal: AbortSignal): Promise<Uint8Array> {
    return this.#caller.call("sound", { group }, { signal });
  }

  /** Decodes a canonical space; files not at hand are fetched. Throws FormatError, TransportError. */
  canonical({ group, quality, tiers }: CanonicalName, signal?: AbortSignal): Promise<Canonical> {
    return this.#caller.call("canonical", { group, quality, tiers }, { signal });
  }

  /** Decodes a segment over a canonical space; files not at hand are fetched. null stands for the canonical space
   * itself. Resolves to the number of frames.
   *
   * Frames are decoded no further ahead of those that were `taken` than 48 MB or two segments, but for one of each
   * call; an aborted signal takes all frames that are left, also after the last one came. Throws FormatError,
   * AbortError. Frames before the first that is wanted have neither luma nor means.
   */
  segment(
    index: number,
    level: number,
    { group, quality, tiers }: CanonicalName,
    onFrame: (t: number, frame: DeltaFrame | null) => void,
    signal?: AbortSignal,
    first = 0,
  ): Promise<number> {
    const onEvent = ({ t, frame }: { t: number; frame: DeltaFrame | null }, id: number) => {
      if (signal?.aborted) return;
      if (frame) this.#frames.set(frame, { id, t });
      onFrame(t, frame);
    };
    return this.#caller.call("segment", { index, level, of: { group, quality, tiers }, first }, { signal, onEvent });
  }

  /** A frame has been shown, or is not wanted any more: others may be decoded. */
  taken(frame: DeltaFrame | null): void {
    const taken = frame && this.#frames.get(frame);
    if (taken) this.#caller.tell({ taken });
  }

  close(): void {
    this.#caller.end();
  }
}

/** The address of a package's folder, with a slash at its end. */
function folder(url: string): string {
  const whole = new URL(url, document.baseURI);
  if (!/^https?:$/.test(whole.protocol))
    throw new UnsupportedError(`expected an address with http or https, got ${whole}`);
  whole.pathname = whole.pathname.replace(/\/+((airgs\.json|manifest\.mpd)\/*)?$|$/, "/");
  whole.hash = "";
  return whole.href;
}

function fetched({ firstByteMs, endMs, bytes, cached, whole, refused }: WireBatch): Fetched {
  const seconds = (ms: number) => (ms - performance.timeOrigin) / 1e3;
  return {
    firstByteS: seconds(firstByteMs),
    endS: seconds(endMs),
    bytes,
    cached,
    whole,
    refused: new Map(refused.map(([path, error]) => [path, fromWire(error) as FormatError])),
  };
}

interface Waiting {
  resolve: (value: Calls[Call]["value"]) => void;
  reject: (error: Error) => void;
  onEvent: (event: Calls[Call]["event"]) => void;
}

class Caller {
  readonly #worker: Worker;
  readonly #waiting = new Map<number, Waiting>();
  #next = 0;
  #ended: Error | null = null;

  /** Throws UnsupportedError where no worker can be started. */
  constructor(
    start: () => Worker,
    private readonly onPassing: (words: string) => void = () => {},
  ) {
    try {
      this.#worker = start();
    } catch (error) {
      throw noWorker(error);
    }
    this.#worker.onmessage = ({ data }: MessageEvent<Reply>) => this.#hear(data);
    this.#worker.onerror = (event) => this.end(noWorker(event.message || "its script was not loaded"));
    this.#worker.onmessageerror = () => this.end(noWorker("a message of it could not be read"));
  }

  /** Calls. An aborted signal makes the worker give up, whose answer says so. */
  call<K extends Call>(
    call: K,
    args: Calls[K]["args"],
    options: { signal?: AbortSignal | undefined; onEvent?: (event: Calls[K]["event"], id: number) => void } = {},
  ): Promise<Calls[K]["value"]> {
    const id = this.#next++;
    if (this.#ended) return Promise.reject(this.#ended);
    const { signal, onEvent } = options;
    const answer = new Promise<Calls[K]["value"]>((resolve, reject) => {
      const hear = (event: Calls[Call]["event"]) => onEvent?.(event as Calls[K]["event"], id);
      this.#waiting.set(id, { resolve: resolve as Waiting["resolve"], reject, onEvent: hear });
    });
    const request: Request<K> = { id, call, args };
    this.#worker.postMessage(request);
    const cancel = () => this.tell({ cancel: id });
    signal?.addEventListener("abort", cancel, { once: true });
    if (signal?.aborted) cancel();
    return answer;
  }

  tell(note: Note): void {
    if (!this.#ended) this.#worker.postMessage(note);
  }

  /** Ends the worker; what is still asked for is rejected. */
  end(error: Error = aborted("closed")): void {
    this.#ended ??= error;
    this.#worker.terminate();
    for (const { reject } of this.#waiting.values()) reject(this.#ended);
    this.#waiting.clear();
  }

  #hear(reply: Reply): void {
    if ("passing" in reply) {
      this.onPassing(reply.passing);
      return;
    }
    const waiting = this.#waiting.get(reply.id);
    if (!waiting) return;
    if ("event" in reply) {
      waiting.onEvent(reply.event);
      return;
    }
    this.#waiting.delete(reply.id);
    if ("error" in reply) waiting.reject(fromWire(reply.error));
    else waiting.resolve(reply.value);
  }
}

function noWorker(why: unknown): UnsupportedError {
  const words = why instanceof Error ? why.message : String(why);
  return new UnsupportedError(`the worker that decodes failed: ${words} (a page's policy must allow worker-src blob:)`);
}

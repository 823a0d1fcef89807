// A package on the web, as the page sees it: the worker fetches, checks and decodes.
import { start } from "worker:./worker.ts";
import type { FormatError } from "../format/errors.ts";
import { MissingTableError } from "../format/index.ts";
import { Tables } from "../format/package.ts";
import type { Canonical, StateFrame } from "../format/types.ts";
import { ATTEMPTS, ROOT_PATH } from "../generated/constants.ts";
import { Caller } from "./caller.ts";
import { fromWire, UnsupportedError } from "./errors.ts";
import type { Retry } from "./http.ts";
import type { CanonicalName, WireBatch } from "./messages.ts";
import { checkBrowser } from "./probe.ts";

export { TransportError, UnsupportedError } from "./errors.ts";
export type { Retry } from "./http.ts";
export type { CanonicalName } from "./messages.ts";

const AHEAD_BYTES = 48 * 2 ** 20;

/** What came of a batch. Times are seconds of performance.now() of the page. */
export interface Fetched {
  /** When the first answer began; `endS` where none did. */
  firstByteS: number;
  endS: number;
  /** Bytes that came over the network, with about 350 for the headers of each answer. */
  bytes: number;
  /** All of it was cached by the browser: the time says nothing of the network. */
  cached: boolean;
  /** Files that came and are what the tables say. */
  whole: string[];
  /** Files that cannot be had, and why. Those that were given up are neither. */
  refused: Map<string, FormatError>;
  /** Answers that were not taken. */
  retries: Retry[];
}

export interface FetchOptions {
  /** Gives up: what is whole by then counts, and the promise resolves. */
  signal?: AbortSignal | undefined;
  /** Is told how many bytes of the batch have come so far. */
  onProgress?: (bytes: number) => void;
  /** Faulty answers after which a file cannot be had. */
  attempts?: number;
}

/** An open package. Groups, segments, levels and qualities count from 0. */
export class Media {
  readonly #caller: Caller;
  readonly #frames = new WeakMap<StateFrame, { id: number; t: number }>();

  private constructor(
    caller: Caller,
    /** The tables that were fetched. */
    readonly tables: Tables,
    /** How this browser gives luma: as it was coded, or so that it can be undone. */
    readonly luma: "exact" | "invertible",
    /** What came of airgs.json. */
    readonly opened: Fetched,
  ) {
    this.#caller = caller;
  }

  /** Opens the package in a folder, or whose airgs.json is at `url`; relative addresses are of the page.
   *
   * Throws FormatError, TransportError where there is no server, UnsupportedError where this browser cannot play
   * packages.
   */
  static async open(url: string, { aheadBytes = AHEAD_BYTES, attempts = ATTEMPTS } = {}): Promise<Media> {
    checkBrowser();
    const caller = new Caller(start);
    try {
      const { luma, batch } = await caller.call("open", { url: folder(url), aheadBytes, attempts });
      const [[, bytes]] = batch.tables;
      return new Media(caller, Tables.parse(bytes), luma, fetched(batch));
    } catch (error) {
      caller.end();
      throw error;
    }
  }

  /** Fetches files at once. Tables among them are added to `tables`; the others are stored as long as there is room. */
  async fetch(paths: string[], options: FetchOptions = {}): Promise<Fetched> {
    const { signal, onProgress, attempts = ATTEMPTS } = options;
    const batch = await this.#caller.call(
      "fetch",
      { paths, attempts },
      { signal, onEvent: (bytes) => onProgress?.(bytes) },
    );
    for (const [path, bytes] of batch.tables) await this.tables.add(path, bytes);
    return fetched(batch);
  }

  /** The segment that shows a frame; fetches the pages and tables of its group, and of its base.
   *
   * Throws FormatError, TransportError.
   */
  async locate(frame: number, signal: AbortSignal): Promise<number> {
    for (;;) {
      try {
        this.tables.baseTable(this.tables.index.atFrame(frame));
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

  /** Decodes the canonical space of a tile, which may have no rows; files that are not at hand are fetched.
   *
   * Throws FormatError, TransportError.
   */
  canonical({ group, tile, quality, tiers }: CanonicalName, signal?: AbortSignal): Promise<Canonical> {
    return this.#caller.call("canonical", { group, tile, quality, tiers }, { signal });
  }

  /** Decodes a segment of the tile of a canonical space; files that are not at hand are fetched. null stands for the
   * canonical space itself. What is asked for at once is decoded side by side. Resolves to the number of frames.
   *
   * Frames are decoded no further ahead of those that were `taken` than 48 MB or two segments, but for one of each
   * call; an aborted signal takes all frames that are left, also after the last one came. Throws FormatError,
   * AbortError.
   */
  segment(
    index: number,
    level: number,
    { group, tile, quality, tiers }: CanonicalName,
    onFrame: (t: number, frame: StateFrame | null) => void,
    signal?: AbortSignal,
  ): Promise<number> {
    const onEvent = ({ t, frame }: { t: number; frame: StateFrame | null }, id: number) => {
      if (signal?.aborted) return;
      if (frame) this.#frames.set(frame, { id, t });
      onFrame(t, frame);
    };
    const of = { group, tile, quality, tiers };
    return this.#caller.call("segment", { index, level, of }, { signal, onEvent });
  }

  /** A frame has been shown, or is not wanted any more: others may be decoded. */
  taken(frame: StateFrame | null): void {
    const taken = frame && this.#frames.get(frame);
    if (taken) this.#caller.tell({ taken });
  }

  /** Ends everything; what is still waited for is rejected. */
  close(): void {
    this.#caller.end();
  }
}

/** The address of a package's folder, with a slash at its end. */
function folder(url: string): string {
  const whole = new URL(url, document.baseURI);
  if (!/^https?:$/.test(whole.protocol))
    throw new UnsupportedError(`expected an address with http or https, got ${whole}`);
  whole.pathname = whole.pathname.replace(/(^|\/)airgs\.json$/, "$1").replace(/\/?$/, "/");
  whole.search = whole.hash = "";
  return whole.href;
}

function fetched({ firstByteMs, endMs, bytes, cached, whole, refused, retries }: WireBatch): Fetched {
  const seconds = (ms: number) => (ms - performance.timeOrigin) / 1e3;
  return {
    firstByteS: seconds(firstByteMs),
    endS: seconds(endMs),
    bytes,
    cached,
    whole,
    refused: new Map(refused.map(([path, error]) => [path, fromWire(error) as FormatError])),
    retries,
  };
}

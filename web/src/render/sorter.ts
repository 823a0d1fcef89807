// Depth orders for the page, made by a worker. N rows of a group.
import { start } from "worker:./sort.ts";
import type { Camera } from "../format/types.ts";
import { type DepthView, depthView, type SortAnswer, type SortRequest } from "./sort.ts";

type Resolve = (rows: SortAnswer) => void;

interface Waiting {
  means: Float32Array | null;
  view: DepthView;
  resolve: Resolve;
}

/** Asks for one order at a time; of each key the newest request waits, and an older one gives null. */
export class Sorter {
  readonly #waiting = new Map<string, Waiting>();
  #sorting: Resolve | null = null;
  #closed = false;

  /** `onFail` is told why the worker fails before it has ever given an order: there will be none. */
  constructor(
    private readonly worker: Worker = start(),
    onFail: (why: string) => void = () => {},
  ) {
    let works = false;
    worker.onmessage = ({ data }: MessageEvent<SortAnswer>) => {
      works = true;
      this.#finish(data);
    };
    worker.onerror = ({ message }) => {
      this.#finish(null);
      if (!works) onFail(message || "its script was not loaded");
    };
  }

  /** Rows far to near for `camera`; null where a newer request came, no means were given, or it was closed.
   *
   * `means` (3N) are of the frame that is shown, world units; null: those given last for this `key`, a scene's.
   */
  order(means: Float32Array | null, key: string, camera: Camera): Promise<SortAnswer> {
    if (this.#closed) return Promise.resolve(null);
    return new Promise((resolve) => {
      const older = this.#waiting.get(key);
      older?.resolve(null);
      this.#waiting.delete(key); // a request waits behind those of other keys
      this.#waiting.set(key, { means: means ?? older?.means ?? null, view: depthView(camera), resolve });
      this.#next();
    });
  }

  forget(key: string): void {
    this.#waiting.get(key)?.resolve(null);
    this.#waiting.delete(key);
    this.#post({ key, means: null, view: null });
  }

  close(): void {
    this.#closed = true;
    this.worker.terminate();
    for (const { resolve } of this.#waiting.values()) resolve(null);
    this.#waiting.clear();
    this.#sorting?.(null);
    this.#sorting = null;
  }

  #next(): void {
    if (this.#sorting) return;
    for (const [key, { means, view, resolve }] of this.#waiting) {
      this.#waiting.delete(key);
      this.#sorting = resolve;
      this.#post({ key, means, view });
      return;
    }
  }

  #finish(rows: SortAnswer): void {
    const resolve = this.#sorting;
    this.#sorting = null;
    this.#next();
    resolve?.(rows);
  }

  #post(request: SortRequest): void {
    if (!this.#closed) this.worker.postMessage(request);
  }
}

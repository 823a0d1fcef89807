// How far decoding may be ahead of the screen.
import { Bell } from "./bell.ts";

/** What is decoded and not taken of a call: the segment, and the bytes of its frames. */
interface Open {
  segment: number;
  frames: Map<number, number>;
}

/** Counts what is decoded and not taken; ids stand for calls under way, each of a segment of a tile. */
export class Ahead {
  readonly #open = new Map<number, Open>();
  readonly #bell = new Bell();
  #bytes = 0;

  /** At most about `bytes`, and `segments` of which something is not taken. */
  constructor(
    readonly bytes: number,
    readonly segments: number,
  ) {}

  /** Resolves when a segment may begin: another one, or another tile of one that has begun. */
  async place(segment: number, signal: AbortSignal): Promise<void> {
    await this.#until(() => {
      const begun = new Set([...this.#open.values()].map((one) => one.segment));
      return begun.has(segment) || begun.size < this.segments;
    }, signal);
  }

  /** Resolves when another picture may be decoded: at once for a call with none ahead, as others need it. */
  async room(id: number, signal: AbortSignal): Promise<void> {
    await this.#until(() => this.#bytes < this.bytes || !this.#open.has(id), signal);
  }

  give(id: number, segment: number, t: number, bytes: number): void {
    const { frames } = this.#open.get(id) ?? { frames: new Map<number, number>() };
    this.#open.set(id, { segment, frames: frames.set(t, bytes) });
    this.#bytes += bytes;
  }

  /** The frame was shown, or is not wanted. */
  taken(id: number, t: number): void {
    const { frames } = this.#open.get(id) ?? {};
    this.#bytes -= frames?.get(t) ?? 0;
    frames?.delete(t);
    if (frames?.size === 0) this.#open.delete(id);
    this.#bell.ring();
  }

  drop(id: number): void {
    for (const t of this.#open.get(id)?.frames.keys() ?? []) this.taken(id, t);
    this.#bell.ring();
  }

  async #until(condition: () => boolean, signal: AbortSignal): Promise<void> {
    const stop = () => this.#bell.ring();
    signal.addEventListener("abort", stop);
    while (!signal.aborted && !condition()) await this.#bell.wait();
    signal.removeEventListener("abort", stop);
  }
}

// Waiting for something to happen.

/** Wakes everybody who waits, each time it rings. */
export class Bell {
  #ring: () => void = () => {};
  #next = this.#after();

  ring(): void {
    this.#ring();
    this.#next = this.#after();
  }

  /** Resolves when `done` says so, which is asked at every ring. */
  async until(done: () => boolean): Promise<void> {
    while (!done()) await this.#next;
  }

  #after(): Promise<void> {
    return new Promise((resolve) => {
      this.#ring = resolve;
    });
  }
}

export const pause = (ms: number): Promise<void> => new Promise((resolve) => setTimeout(resolve, ms));

/** A controller that aborts with `signal`; whoever has it aborts it in the end, which also removes its listener. */
export function following(signal: AbortSignal): AbortController {
  const own = new AbortController();
  signal.addEventListener("abort", () => own.abort(), { signal: own.signal });
  if (signal.aborted) own.abort();
  return own;
}

/** Waits so many ms, or until the signal aborts or what `listen` listens to happens; it gives how to stop. */
export function waitFor(ms: number, signal: AbortSignal, listen: (end: () => void) => () => void): Promise<void> {
  return new Promise((resolve) => {
    const timer = setTimeout(end, ms);
    const forget = listen(end);
    function end() {
      clearTimeout(timer);
      forget();
      signal.removeEventListener("abort", end);
      resolve();
    }
    signal.addEventListener("abort", end);
    if (signal.aborted) end();
  });
}

/** Waits so many milliseconds; less long where the browser says that it is online again, or the signal aborts. */
export const untilOnline = (ms: number, signal: AbortSignal): Promise<void> =>
  waitFor(ms, signal, (end) => {
    globalThis.addEventListener?.("online", end);
    return () => globalThis.removeEventListener?.("online", end);
  });

/** Counts what is decoded and not taken; ids stand for calls under way, each of a segment. */
export class Ahead {
  /** By call: the bytes of its frames. */
  readonly #open = new Map<number, Map<number, number>>();
  readonly #bell = new Bell();
  #bytes = 0;

  /** At most about `bytes`, and `segments` of which something is not taken. */
  constructor(
    readonly bytes: number,
    readonly segments: number,
  ) {}

  get idle(): boolean {
    return this.#open.size === 0;
  }

  async place(signal: AbortSignal): Promise<void> {
    await this.#until(() => this.#open.size < this.segments, signal);
  }

  /** Resolves when another picture may be decoded: at once for a call with none ahead, as others need it. */
  async room(id: number, signal: AbortSignal): Promise<void> {
    await this.#until(() => this.#bytes < this.bytes || !this.#open.has(id), signal);
  }

  give(id: number, t: number, bytes: number): void {
    this.#open.set(id, (this.#open.get(id) ?? new Map<number, number>()).set(t, bytes));
    this.#bytes += bytes;
  }

  taken(id: number, t: number): void {
    const frames = this.#open.get(id);
    this.#bytes -= frames?.get(t) ?? 0;
    frames?.delete(t);
    if (frames?.size === 0) this.#open.delete(id);
    this.#bell.ring();
  }

  drop(id: number): void {
    for (const t of this.#open.get(id)?.keys() ?? []) this.taken(id, t);
  }

  async #until(condition: () => boolean, signal: AbortSignal): Promise<void> {
    const stop = () => this.#bell.ring();
    signal.addEventListener("abort", stop);
    await this.#bell.until(() => signal.aborted || condition());
    signal.removeEventListener("abort", stop);
  }
}

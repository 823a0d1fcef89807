// Waiting for something to happen.

/** Wakes everybody who waits, each time it rings. */
export class Bell {
  #ring: () => void = () => {};
  #next = this.#after();

  ring(): void {
    this.#ring();
    this.#next = this.#after();
  }

  /** Resolves when the bell rings next. */
  wait(): Promise<void> {
    return this.#next;
  }

  #after(): Promise<void> {
    return new Promise((resolve) => {
      this.#ring = resolve;
    });
  }
}

/** Waits so many milliseconds. */
export const pause = (ms: number): Promise<void> => new Promise((resolve) => setTimeout(resolve, ms));

/** Waits so many milliseconds; less long where the browser says that it is online again, or the signal aborts. */
export function untilOnline(ms: number, signal: AbortSignal): Promise<void> {
  return new Promise((resolve) => {
    const timer = setTimeout(end, ms);
    function end() {
      clearTimeout(timer);
      signal.removeEventListener("abort", end);
      globalThis.removeEventListener?.("online", end);
      resolve();
    }
    signal.addEventListener("abort", end);
    globalThis.addEventListener?.("online", end);
    if (signal.aborted) end();
  });
}

// Waiting for something to happen.

/** Wakes everybody who waits, each time it rings. */
export class Bell {
  #ring: () => void = () => {};
  #next = this.#after();

  ring(): void {
    this.#ring();
    this.#next = this.#after();
  }

  wait(): Promise<void> {
    return this.#next;
  }

  #after(): Promise<void> {
    return new Promise((resolve) => {
      this.#ring = resolve;
    });
  }
}

export const pause = (ms: number): Promise<void> => new Promise((resolve) => setTimeout(resolve, ms));

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

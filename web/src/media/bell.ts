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

/** Waits so many milliseconds, or until one of the others comes. */
export function pause(ms: number, ...others: Promise<unknown>[]): Promise<void> {
  let timer: ReturnType<typeof setTimeout> | undefined;
  const late = new Promise<unknown>((resolve) => {
    timer = setTimeout(resolve, ms);
  });
  return Promise.race([late, ...others]).then(() => clearTimeout(timer));
}

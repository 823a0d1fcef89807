// Arrays joined, and values of which the last used stay.

/** Arrays of a kind one after another. */
export function concat<T extends Uint8Array | Float32Array>(kind: new (length: number) => T, parts: readonly T[]): T {
  const whole = new kind(parts.reduce((sum, part) => sum + part.length, 0));
  let at = 0;
  for (const part of parts) {
    whole.set(part, at);
    at += part.length;
  }
  return whole;
}

/** Values by their keys, of which the last used stay: at most so many, or so much by `sizeOf`, the newest aside. */
export class Recent<Key, Value> {
  readonly #values = new Map<Key, Value>(); // its order is that of adding: the last used is the last
  #size = 0;

  constructor(
    readonly most: number,
    readonly sizeOf: (value: Value) => number = () => 1,
  ) {}

  has(key: Key): boolean {
    return this.#values.has(key);
  }

  get(key: Key): Value | undefined {
    const value = this.#values.get(key);
    return value === undefined ? undefined : this.set(key, value);
  }

  set(key: Key, value: Value): Value {
    this.delete(key);
    this.#values.set(key, value);
    this.#size += this.sizeOf(value);
    for (const oldest of this.#values.keys()) {
      if (this.#size <= this.most || oldest === key) break;
      this.delete(oldest);
    }
    return value;
  }

  delete(key: Key): void {
    const value = this.#values.get(key);
    if (value !== undefined) this.#size -= this.sizeOf(value);
    this.#values.delete(key);
  }

  of(key: Key, make: () => Value): Value {
    return this.get(key) ?? this.set(key, make());
  }

  entries(): Iterable<[Key, Value]> {
    return this.#values.entries();
  }
}

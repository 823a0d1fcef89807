/** Values by their keys, of which at most so many are there: the last used. */
export class Recent<Key, Value> {
  readonly #values = new Map<Key, Value>(); // its order is that of adding: the last used is the last

  constructor(readonly most: number) {}

  has(key: Key): boolean {
    return this.#values.has(key);
  }

  get(key: Key): Value | undefined {
    const value = this.#values.get(key);
    return value === undefined ? undefined : this.set(key, value);
  }

  set(key: Key, value: Value): Value {
    this.#values.delete(key);
    this.#values.set(key, value);
    for (const oldest of this.#values.keys()) {
      if (this.#values.size <= this.most) break;
      this.#values.delete(oldest);
    }
    return value;
  }

  /** The value of a key, which is made where it is not there. */
  of(key: Key, make: () => Value): Value {
    return this.get(key) ?? this.set(key, make());
  }

  entries(): Iterable<[Key, Value]> {
    return this.#values.entries();
  }
}

// Files that were fetched and not used yet.

/** Keeps bytes by path; the files that were used least lately go first when there are too many. */
export class ByteStore {
  readonly #files = new Map<string, Uint8Array>();
  #bytes = 0;

  constructor(readonly limit: number) {}

  get bytes(): number {
    return this.#bytes;
  }

  put(path: string, bytes: Uint8Array): void {
    this.drop(path);
    this.#files.set(path, bytes);
    this.#bytes += bytes.length;
    for (const oldest of this.#files.keys()) {
      if (this.#bytes <= this.limit || oldest === path) break;
      this.drop(oldest);
    }
  }

  get(path: string): Uint8Array | undefined {
    const bytes = this.#files.get(path);
    if (!bytes) return undefined;
    this.#files.delete(path); // the order of a Map is that of adding: the last used is the last
    this.#files.set(path, bytes);
    return bytes;
  }

  drop(path: string): void {
    this.#bytes -= this.#files.get(path)?.length ?? 0;
    this.#files.delete(path);
  }
}

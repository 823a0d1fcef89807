// Writes column files (FORMAT.md, section 7) for tests: the other direction of src/format/rangecoder.ts, from the text.

const NODES = 64 + (64 << 3);
const WHOLE = 2 ** 32 - 1;

/** Numbers below 2^32 of one order. */
export interface Column {
  order: 0 | 1;
  numbers: readonly number[];
}

/** The file of columns. */
export function columnFile(columns: readonly Column[]): Uint8Array {
  const stream = new Stream();
  for (const column of columns) writeColumn(stream, column);
  return stream.bytes();
}

function writeColumn(stream: Stream, { order, numbers }: Column): void {
  const models = new Map<number, { chance: number; seen: number }>();
  const modelled = (place: number, decision: number) => {
    const model = models.get(place) ?? { chance: 32768, seen: 0 };
    models.set(place, model);
    stream.write(decision, Math.floor(stream.range / 2 ** 15) * Math.min(Math.max(model.chance >> 1, 16), 32752));
    model.chance += Math.floor((2 * (65535 * decision - model.chance)) / (2 * model.seen + 3));
    model.seen = Math.min(model.seen + 1, 60);
  };
  let base = 0;
  for (const number of numbers) {
    const bits = number ? 32 - Math.clz32(number) : 0;
    for (let i = 5, node = 1; i >= 0; i--) {
      modelled(base + node, (bits >> i) & 1);
      node = 2 * node + ((bits >> i) & 1);
    }
    for (let i = bits - 2, node = 1, sent = 0; i >= 0; i--, sent++) {
      const bit = (number >>> i) & 1;
      if (sent < 3) modelled(base + 64 + (bits << 3) + node, bit);
      else stream.write(bit, Math.floor(stream.range / 2));
      node = 2 * node + bit;
    }
    if (order) base = Math.min(number, 15) * NODES;
  }
}

/** The decisions of a stream, as one large number. */
class Stream {
  range = WHOLE;
  #low = 0n;
  #length = 4;

  /** `share` of the range stands for a 1. */
  write(decision: number, share: number): void {
    if (!decision) this.#low += BigInt(share);
    this.range = decision ? share : this.range - share;
    while (this.range < 2 ** 24) {
      this.range *= 256;
      this.#low *= 256n;
      this.#length++;
    }
  }

  bytes(): Uint8Array {
    const digits = this.#low.toString(16).padStart(2 * this.#length, "0");
    return Uint8Array.from([0, ...Buffer.from(digits, "hex")]);
  }
}

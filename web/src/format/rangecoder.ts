// Column files: FORMAT.md, section 7. Numbers of 63 bits are two halves, since a number of JavaScript holds 53.
import {
  CHANCE_HALF,
  CHANCE_LEAST,
  END_BYTES,
  LENGTH_BITS,
  MODEL_CONTEXTS,
  MODEL_MEMORY,
  MODELLED_BITS,
  RANGE_LEAST,
  RANGE_START,
} from "../generated/constants.ts";
import { FormatError } from "./errors.ts";

const LENGTHS = 1 << LENGTH_BITS; // nodes of the tree of bit lengths
const NODES = LENGTHS + (LENGTHS << MODELLED_BITS);
const RECIPROCALS = Float64Array.from({ length: MODEL_MEMORY + 1 }, (_, seen) => 1 / (2 * seen + 3));
// Places in the state, which is an array of whole numbers since fields of an object would be floats.
const RANGE = 0;
const CODE = 1;
// Numbers that a byte can hold at most: a decision takes log2(1 / (1 − 16 / 32768)) bits or more, a number six of them.
const DENSEST = 2048;

export interface Wide {
  lo: Uint32Array;
  hi: Uint32Array;
}

/** Decodes the columns of a file in order. Everything throws FormatError(bad_sidecar). */
export class ColumnReader {
  #data: Uint8Array;
  #absent: boolean;
  #state = Uint32Array.of(RANGE_START, 0);
  #at = END_BYTES;
  #chances = new Uint16Array(0);
  #seen = new Uint8Array(0);

  /** `data` null: every number is 0. `where` names the file in errors. */
  constructor(
    data: Uint8Array | null,
    readonly where: string,
  ) {
    this.#absent = data === null;
    this.#data = data ?? new Uint8Array(END_BYTES);
    if (this.#data.length < END_BYTES)
      throw this.refuse(`expected at least ${END_BYTES} bytes, got ${this.#data.length}`);
    const [first, a, b, c, d] = this.#data as unknown as [number, number, number, number, number];
    if (first) throw this.refuse(`expected a first byte of 0, got ${first}`);
    this.#state[CODE] = (a << 24) | (b << 16) | (c << 8) | d;
    // Such a value stays at or above the range, and is never 0 at the end.
    if (this.#state[CODE] === RANGE_START) throw this.refuse("expected a value inside the range");
  }

  /** The next column: `count` numbers of an order, each below 2³². */
  column(count: number, order: 0 | 1): Uint32Array {
    const { lo, hi } = this.wide(count, order);
    if (hi.some((high) => high > 0)) throw this.refuse("expected numbers below 2^32");
    return lo;
  }

  wide(count: number, order: 0 | 1): Wide {
    if (!this.#absent && count > DENSEST * (this.#data.length + END_BYTES)) throw this.#tooShort(count);
    const column = { lo: new Uint32Array(count), hi: new Uint32Array(count) };
    if (this.#absent) return column;
    this.#chances = new Uint16Array((order ? MODEL_CONTEXTS : 1) * NODES).fill(CHANCE_HALF);
    this.#seen = new Uint8Array(this.#chances.length);
    this.#fill(column, order);
    return column;
  }

  close(): void {
    if (this.#at !== this.#data.length || this.#state[CODE]) {
      throw this.refuse(`expected the end at ${this.#at}, got ${this.#data.length} bytes`);
    }
  }

  refuse(detail: string): FormatError {
    return new FormatError("bad_sidecar", this.where, detail);
  }

  #tooShort(count: number): FormatError {
    return this.refuse(`expected ${count} numbers, got the end of the file`);
  }

  #fill({ lo, hi }: Wide, order: 0 | 1): void {
    let base = 0;
    for (let k = 0; k < lo.length; k++) {
      let node = 1;
      for (let i = 0; i < LENGTH_BITS; i++) node = 2 * node + this.#modelled(base + node);
      const bits = node - LENGTHS;
      const models = base + LENGTHS + (bits << MODELLED_BITS);
      let low = bits ? 1 : 0;
      let high = 0;
      // The bits so far are the number of the node.
      for (let i = 1; i < bits && i <= MODELLED_BITS; i++) low = 2 * low + this.#modelled(models + low);
      for (let i = 1 + MODELLED_BITS; i < bits; i++) {
        high = (high << 1) | (low >>> 31);
        low = (low << 1) | this.#take(this.#state[RANGE]! >>> 1);
      }
      lo[k] = low;
      hi[k] = high;
      if (order) base = (high || low >>> 0 >= MODEL_CONTEXTS ? MODEL_CONTEXTS - 1 : low) * NODES;
    }
    if (this.#at > this.#data.length) throw this.#tooShort(lo.length);
  }

  #modelled(model: number): number {
    const chance = this.#chances[model]!;
    const seen = this.#seen[model]!;
    const one = this.#take(
      Math.imul(
        this.#state[RANGE]! >>> 15,
        Math.min(Math.max(chance >> 1, CHANCE_LEAST), CHANCE_HALF - CHANCE_LEAST),
      ) >>> 0,
    );
    // Whole numbers are divided and rounded down: half a unit more keeps the product with the reciprocal off borders.
    // A number below 0 rounds to the one of its size, rounded up.
    const weight = 2 * seen + 3;
    this.#chances[model] = one
      ? chance + (((2 * (65535 - chance) + 0.5) * RECIPROCALS[seen]!) | 0)
      : chance - (((2 * chance + weight - 1 + 0.5) * RECIPROCALS[seen]!) | 0);
    if (seen < MODEL_MEMORY) this.#seen[model] = seen + 1;
    return one;
  }

  #take(share: number): number {
    const state = this.#state;
    const one = state[CODE]! < share ? 1 : 0;
    let range = one ? share : state[RANGE]! - share;
    let code = one ? state[CODE]! : state[CODE]! - share;
    while (range < RANGE_LEAST) {
      range = (range << 8) >>> 0;
      code = ((code << 8) | (this.#at < this.#data.length ? this.#data[this.#at]! : 0)) >>> 0;
      this.#at++;
    }
    state[RANGE] = range;
    state[CODE] = code;
    return one;
  }
}

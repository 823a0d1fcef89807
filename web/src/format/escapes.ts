// Escapes, by which values leave 8 bits: FORMAT.md, section 6. T frames, P planes, N rows, E jumps.
import { planeCorner, rowOffsets } from "./atlas.ts";
import type { ColumnReader } from "./rangecoder.ts";
import type { Atlas, BaseChanges } from "./types.ts";

/** The jumps of the bases of a segment or of a key picture. */
export interface Escapes {
  /** (E) ascending flat indices (t · P + p) · N + i. */
  index: Float64Array;
  /** (E) by how much bases change. */
  jumps: Int32Array;
}

/** The escapes that `reader` reads next. Throws FormatError(bad_sidecar). */
export function readEscapes(reader: ColumnReader, frames: number, planes: number, rows: number): Escapes {
  const samples = frames * planes * rows; // at most 10⁶ · 55 · 2²⁴: exact
  const number = reader.wide(1, 0);
  const count = number.hi[0]! * 2 ** 32 + number.lo[0]!;
  if (count > samples) throw reader.refuse(`expected at most ${samples} escapes, got ${count}`);
  const gaps = reader.wide(count, 0);
  const zigzag = reader.column(count, 1);
  const index = new Float64Array(count);
  let at = 0;
  for (let e = 0; e < count; e++) {
    const gap = gaps.hi[e]! * 2 ** 32 + gaps.lo[e]!;
    at += gap;
    if ((e && !gap) || at >= samples) throw reader.refuse("escapes are not in ascending order inside the segment");
    index[e] = at;
  }
  return { index, jumps: Int32Array.from(zigzag, (z) => (z >>> 1) ^ -(z & 1)) };
}

/** The bases of an atlas from picture to picture; every picture of a file is to be asked for, in order. */
export class Bases {
  #offsets: Uint32Array;
  #now = new Map<number, number>();
  #at = 0;

  constructor(
    readonly escapes: Escapes,
    readonly atlas: Atlas,
  ) {
    this.#offsets = rowOffsets(atlas);
  }

  /** The changes that come with picture `t`; null: none. */
  next(t: number): BaseChanges | null {
    const { index, jumps } = this.escapes;
    const { rows, planes } = this.atlas;
    const area = planes.length * rows;
    const first = this.#at;
    while (this.#at < index.length && index[this.#at]! < (t + 1) * area) this.#at++;
    if (this.#at === first) return null;
    const texels = new Uint32Array(this.#at - first);
    const bases = new Int32Array(this.#at - first);
    for (let e = first; e < this.#at; e++) {
      const sample = index[e]! % area;
      const texel = planeCorner(this.atlas, Math.floor(sample / rows)) + this.#offsets[sample % rows]!;
      const base = (this.#now.get(texel) ?? 0) + jumps[e]!;
      this.#now.set(texel, base | 0);
      texels[e - first] = texel;
      bases[e - first] = base;
    }
    return { texels, bases };
  }
}

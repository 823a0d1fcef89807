// Positions, motion classes and depths of rows, and escapes: FORMAT.md, sections 3 and 6. N rows of a tier.
import { LEAST_CLASS, LIMITS, MOST_CLASS, MOST_WIDER, STATIC } from "../generated/constants.ts";
import { ColumnReader, type Wide } from "./rangecoder.ts";
import type { Grid } from "./types.ts";

/** The N rows of a tier, M of them with places: none where keyframes are differences, else all. */
export interface TierRows {
  /** (M) Morton codes of the corners of cells. */
  codes: Wide;
  /** (M) motion classes, LEAST_CLASS … MOST_CLASS. */
  classes: Int16Array;
  /** (M) e of the grid, 2^e times as wide, that a row lies in. */
  wider: Int32Array;
  /** (N) deepest level that carries a row; STATIC: none. */
  depths: Uint8Array;
}

/** The jumps of the bases of a segment or of a keyframe picture; of a sidecar the e of rows (T = P = 1). */
export interface Escapes {
  /** (E) ascending flat indices (t · P + p) · N + i. */
  index: Float64Array;
  /** (E) by how much bases change. */
  jumps: Int32Array;
}

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

/** b of the i-th row: its cell is 2^b steps of its grid wide. `coarser` is that of a keyframe quality. */
function cellBits(
  { classes, wider }: Pick<TierRows, "classes" | "wider">,
  i: number,
  grid: Grid,
  coarser: number,
): number {
  const k = Math.min(Math.max(classes[i]! - wider[i]! - grid.finest, 0), LIMITS.bits);
  return Math.min(k + coarser, LIMITS.bits);
}

/** A sidecar, with codes of the last quality, whose `coarser` is `coarsest`. Throws FormatError(bad_sidecar). */
export function readSidecar(
  data: Uint8Array,
  count: number, // N
  placed: number, // M
  grid: Grid,
  coarsest: number,
  where: string,
): TierRows {
  const reader = new ColumnReader(data, where);
  const [told, lowest = 0] = reader.column(placed ? 2 : 0, 0);
  if (placed) expectCells(reader, told, coarsest);
  const above = reader.column(placed, 1);
  const codes = reader.wide(placed, 0);
  const carried = reader.column(count, 1);
  if (carried.some((depth) => depth > STATIC)) throw reader.refuse(`expected depths up to ${STATIC}`);
  const depths = Uint8Array.from(carried, (depth) => depth - 1); // 0 − 1 is STATIC
  const wider = new Int32Array(placed);
  if (placed) {
    const { index, jumps } = readEscapes(reader, 1, 1, placed);
    index.forEach((row, n) => {
      wider[row] = jumps[n]!;
    });
  }
  reader.close();
  if (wider.some((e) => e < 0 || e > MOST_WIDER)) throw reader.refuse(`expected e up to ${MOST_WIDER}`);
  if (above.some((more) => LEAST_CLASS + lowest + more > MOST_CLASS))
    throw reader.refuse(`expected motion classes up to ${MOST_CLASS}`);
  const classes = Int16Array.from(above, (more) => LEAST_CLASS + lowest + more);
  const rows = { codes, classes, wider, depths };
  if (!sumGaps(rows, grid, coarsest)) throw reader.refuse(`Morton codes leave ${3 * LIMITS.bits} bits`);
  return rows;
}

/** The upper half of a number of 64 bits after a shift to the left. */
const shifted = (hi: number, lo: number, shift: number) =>
  shift >= 32 ? lo << (shift - 32) : shift ? (hi << shift) | (lo >>> (32 - shift)) : hi;

const exceeds = (hi: number, lo: number, bits: number): boolean =>
  bits < 32 ? hi > 0 || lo >= 2 ** bits : hi >= 2 ** (bits - 32);

/** Turns gaps between neighbours into Morton codes. False when a code does not fit the grid. */
function sumGaps(rows: TierRows, grid: Grid, coarsest: number): boolean {
  const { lo, hi } = rows.codes;
  let low = 0;
  let high = 0;
  for (let i = 0; i < lo.length; i++) {
    const shift = 3 * cellBits(rows, i, grid, coarsest);
    const room = 3 * LIMITS.bits - shift; // bits of a code without those of its cell
    // Codes shifted by the bits of the cell, as two halves, and their sum.
    const before = shift >= 32 ? high >>> (shift - 32) : shift ? (low >>> shift) | (high << (32 - shift)) : low;
    const sum = (before >>> 0) + lo[i]!;
    const top = (shift >= 32 ? 0 : high >>> shift) + hi[i]! + (sum > 0xffffffff ? 1 : 0);
    if (exceeds(top, sum, room)) return false;
    high = shifted(top, sum >>> 0, shift) >>> 0;
    low = shift >= 32 ? 0 : (sum << shift) >>> 0;
    lo[i] = low;
    hi[i] = high;
  }
  return true;
}

/** The same rows with the codes of a keyframe quality, from its detail. Throws FormatError(bad_sidecar). */
export function readDetail(
  reader: ColumnReader,
  shared: TierRows,
  grid: Grid,
  coarser: number,
  coarsest: number,
): TierRows {
  if (coarser === coarsest) return shared;
  expectCells(reader, reader.column(1, 0)[0], coarser);
  const codes = reader.wide(shared.classes.length, 0);
  const { lo, hi } = codes;
  for (let i = 0; i < lo.length; i++) {
    const shift = 3 * cellBits(shared, i, grid, coarser);
    const room = 3 * cellBits(shared, i, grid, coarsest) - shift;
    const high = hi[i]!;
    const low = lo[i]!;
    if (exceeds(high, low, room)) throw reader.refuse("the detail of a position leaves its cell");
    hi[i] = shared.codes.hi[i]! | shifted(high, low, shift);
    lo[i] = shared.codes.lo[i]! | (shift >= 32 ? 0 : low << shift);
  }
  return { ...shared, codes };
}

function expectCells(reader: ColumnReader, told: number | undefined, coarser: number): void {
  if (told !== coarser) throw reader.refuse(`expected coarser ${coarser}, got ${told}`);
}

/** Every third bit of a number of 32 bits, from the lowest on, next to each other: 11 bits. */
function everyThird(bits: number): number {
  let v = bits & 0x49249249;
  v = (v | (v >>> 2)) & 0xc30c30c3;
  v = (v | (v >>> 4)) & 0x0f00f00f;
  v = (v | (v >>> 8)) & 0xff0000ff;
  return (v | (v >>> 16)) & 0x7ff;
}

/** Grid index on an axis (0, 1, 2) of a Morton code, at most 21 bits. */
export function mortonIndex(lo: number, hi: number, axis: number): number {
  // Bits 0 … 29 of the code give ten bits of each axis, bits 30 … 59 the next ten, bit 60 + axis the last.
  const middle = everyThird(((lo >>> 30) | (hi << 2)) >>> axis);
  return everyThird((lo & 0x3fffffff) >>> axis) | (middle << 10) | (((hi >>> (28 + axis)) & 1) << 20);
}

/** (3N) canonical means of a keyframe quality, world units. */
export function canonicalMeans(rows: TierRows, grid: Grid, coarser: number): Float64Array {
  const { codes, wider } = rows;
  const half = 2 ** (LIMITS.bits - 1);
  const means = new Float64Array(3 * wider.length);
  for (let i = 0; i < wider.length; i++) {
    const cell = 1 << cellBits(rows, i, grid, coarser);
    for (let axis = 0; axis < 3; axis++) {
      const index = mortonIndex(codes.lo[i]!, codes.hi[i]!, axis);
      const away = (index + cell / 2 - half) * 2 ** wider[i]!;
      means[3 * i + axis] = grid.step * (grid.origin[axis]! + half + away);
    }
  }
  return means;
}

const UNITS = Float32Array.from({ length: MOST_CLASS - LEAST_CLASS + 1 }, (_, i) => 2 ** (i + LEAST_CLASS));

/** (N) motion unit 2^c of each row, world units. */
export const motionUnits = (classes: Int16Array) => new Float32Array(classes).map((c) => UNITS[c - LEAST_CLASS]!);

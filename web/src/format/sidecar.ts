// Positions, motion classes and depths of rows: FORMAT.md, section 3. N rows of a tier.
import { LEAST_CLASS, MOST_CLASS, STATIC } from "../generated/constants.ts";
import { type ColumnReader, ColumnReader as Reader, type Wide } from "./rangecoder.ts";
import type { Grid } from "./types.ts";

/** The N rows of a tier as a sidecar and the detail of a quality give them, M of them with their places. */
export interface TierRows {
  /** (M) Morton codes of the corners of cells. */
  codes: Wide;
  /** (M) motion classes, LEAST_CLASS … MOST_CLASS. */
  classes: Int16Array;
  /** (N) deepest level that carries a row; STATIC: none. */
  depths: Uint8Array;
}

/** N and M: M is 0 where keys are differences, else N. */
export interface TierCounts {
  count: number;
  placed: number;
}

/** b of a row: its cell is 2^b steps of the grid wide. `coarser` is that of a key quality. */
export function cellBits(motionClass: number, grid: Grid, coarser: number): number {
  const k = Math.min(Math.max(motionClass - grid.finest, 0), grid.bits);
  return Math.min(k + coarser, grid.bits);
}

/** A sidecar, with codes of the last quality, `coarsest` its `coarser`. Throws FormatError(bad_sidecar). */
export function readSidecar(
  data: Uint8Array,
  { count, placed }: TierCounts,
  grid: Grid,
  coarsest: number,
  where: string,
): TierRows {
  const reader = new Reader(data, where);
  const depths = new Uint8Array(count);
  const least = placed ? reader.column(1, 0)[0]! + LEAST_CLASS : 0;
  const above = reader.column(placed, 1);
  const codes = reader.wide(placed, 0);
  const carried = reader.column(count, 1);
  if (carried.some((depth) => depth > STATIC)) throw reader.refuse(`expected depths up to ${STATIC}`);
  depths.set(carried.map((depth) => depth - 1)); // 0 − 1 is STATIC
  reader.close();
  const classes = new Int16Array(placed);
  for (let i = 0; i < placed; i++) {
    const motionClass = least + above[i]!;
    if (motionClass > MOST_CLASS) throw reader.refuse(`expected motion classes up to ${MOST_CLASS}`);
    classes[i] = motionClass;
  }
  if (!sumGaps(codes, classes, grid, coarsest)) throw reader.refuse(`Morton codes leave ${3 * grid.bits} bits`);
  return { codes, classes, depths };
}

/** Turns gaps between neighbours into Morton codes. False when a code does not fit the grid. */
function sumGaps({ lo, hi }: Wide, classes: Int16Array, grid: Grid, coarsest: number): boolean {
  let low = 0;
  let high = 0;
  for (let i = 0; i < lo.length; i++) {
    const shift = 3 * cellBits(classes[i]!, grid, coarsest);
    const room = 3 * grid.bits - shift; // bits of a code without those of its cell
    // Codes shifted by the bits of the cell, as two halves, and their sum.
    const before = shift >= 32 ? high >>> (shift - 32) : shift ? (low >>> shift) | (high << (32 - shift)) : low;
    const sum = (before >>> 0) + lo[i]!;
    const top = (shift >= 32 ? 0 : high >>> shift) + hi[i]! + (sum > 0xffffffff ? 1 : 0);
    if (room < 32 ? top || sum >= 2 ** room : top >= 2 ** (room - 32)) return false;
    high = shift >= 32 ? sum << (shift - 32) : shift ? (top << shift) | ((sum >>> 0) >>> (32 - shift)) : top;
    low = shift >= 32 ? 0 : sum << shift;
    lo[i] = low;
    hi[i] = high;
    low >>>= 0;
    high >>>= 0;
  }
  return true;
}

/** The same rows with the codes of a key quality, from its detail. Throws FormatError(bad_sidecar). */
export function readDetail(
  reader: ColumnReader,
  shared: TierRows,
  grid: Grid,
  coarser: number,
  coarsest: number,
): TierRows {
  if (coarser === coarsest) return shared;
  const codes = reader.wide(shared.classes.length, 0);
  const { lo, hi } = codes;
  for (let i = 0; i < lo.length; i++) {
    const shift = 3 * cellBits(shared.classes[i]!, grid, coarser);
    const room = 3 * cellBits(shared.classes[i]!, grid, coarsest) - shift;
    const low = lo[i]!;
    const high = hi[i]!;
    if (room < 32 ? high || low >= 2 ** room : high >= 2 ** (room - 32)) {
      throw reader.refuse("the detail of a position leaves its cell");
    }
    hi[i] =
      shared.codes.hi[i]! |
      (shift >= 32 ? low << (shift - 32) : shift ? (high << shift) | (low >>> (32 - shift)) : high);
    lo[i] = shared.codes.lo[i]! | (shift >= 32 ? 0 : low << shift);
  }
  return { ...shared, codes };
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
  // Bits 0 … 29 give ten bits of each axis; the others, shifted down to bit 0, the upper eleven.
  return (
    everyThird((lo & 0x3fffffff) >>> axis) | (everyThird(((lo >>> 30) | (hi << 2)) >>> axis) << 10) | topBit(hi, axis)
  );
}

/** Bit 20 of an axis, which stands in bit 60 + axis of the code. */
const topBit = (hi: number, axis: number) => ((hi >>> (28 + axis)) & 1) << 20;

/** (3N) canonical means of a key quality, world units. */
export function canonicalMeans({ codes, classes }: TierRows, grid: Grid, coarser: number): Float64Array {
  const means = new Float64Array(3 * classes.length);
  for (let i = 0; i < classes.length; i++) {
    const cell = 1 << cellBits(classes[i]!, grid, coarser);
    for (let axis = 0; axis < 3; axis++) {
      const index = mortonIndex(codes.lo[i]!, codes.hi[i]!, axis);
      means[3 * i + axis] = grid.origin[axis]! + grid.step * (index + cell / 2);
    }
  }
  return means;
}

const UNITS = Float32Array.from({ length: MOST_CLASS - LEAST_CLASS + 1 }, (_, i) => 2 ** (i + LEAST_CLASS));

/** (N) motion unit 2^c of each row, world units. */
export const motionUnits = (classes: Int16Array) => new Float32Array(classes).map((c) => UNITS[c - LEAST_CLASS]!);

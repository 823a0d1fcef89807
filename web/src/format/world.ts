// Where a scene stands in a world with y up: FORMAT.md, section 8. A transform is three rows of a turn, times a scale,
// with a shift.
import type { World } from "./types.ts";
import { cross, dot, length, scaled, unit, type Vector } from "./vector.ts";

const LEAST_SCALE = 1e-6;
const MOST_SCALE = 1e6;
/** Of the products of axes of length 1. */
const TOLERANCE = 1e-5;

const rowsOf = ({ transform: t }: World): [Vector, Vector, Vector] => [
  [t[0]!, t[1]!, t[2]!],
  [t[4]!, t[5]!, t[6]!],
  [t[8]!, t[9]!, t[10]!],
];

/** What is wrong with a transform; null: it is a similarity that does not mirror. */
export function faultOf(world: World): string | null {
  const rows = rowsOf(world);
  const scale = rows.reduce((sum, row) => sum + length(row), 0) / 3;
  if (!(scale >= LEAST_SCALE && scale <= MOST_SCALE)) {
    return `expected a scale of ${LEAST_SCALE} to ${MOST_SCALE}, got ${scale}`;
  }
  const axes = rows.map((row) => scaled(row, 1 / scale)) as [Vector, Vector, Vector];
  const off = axes.flatMap((a, i) => axes.map((b, j) => Math.abs(dot(a, b) - (i === j ? 1 : 0))));
  if (Math.max(...off) > TOLERANCE) return `expected a rotation with one scale for all axes, got rows ${rows}`;
  return dot(cross(axes[0], axes[1]), axes[2]) < 0 ? "expected a right-handed turn, got one that mirrors" : null;
}

/** Which way is up in the coordinates of the scene, of length 1. */
export const upOf = (world: World): Vector => unit(rowsOf(world)[1]);

// Where a scene stands in a world with y up: FORMAT.md, section 8. A transform is three rows of a turn, times a scale,
// with a shift.
import { LEAST_SCALE, MOST_SCALE, WORLD_TOLERANCE } from "../generated/constants.ts";
import type { World } from "./types.ts";
import { cross, dot, length, unit, type Vector, vector } from "./vector.ts";

const row = ({ transform }: World, i: number): Vector => vector(transform.slice(4 * i));

/** Whether a transform is a similarity that does not mirror. */
export function isSimilarity(world: World): boolean {
  const rows = [row(world, 0), row(world, 1), row(world, 2)] as const;
  const scale = (length(rows[0]) + length(rows[1]) + length(rows[2])) / 3;
  const near = (product: number, expected: number) => Math.abs(product / scale ** 2 - expected) <= WORLD_TOLERANCE;
  const turned = rows.every((a, i) => rows.every((b, j) => near(dot(a, b), +(i === j))));
  const bounded = scale <= MOST_SCALE * (1 + WORLD_TOLERANCE) && scale >= LEAST_SCALE * (1 - WORLD_TOLERANCE);
  return turned && bounded && dot(cross(rows[0], rows[1]), rows[2]) > 0;
}

/** Which way is up in the coordinates of the scene, of length 1. */
export const upOf = (world: World): Vector => unit(row(world, 1));

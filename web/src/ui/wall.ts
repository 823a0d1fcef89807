// The soft wall of the viewing region: a viewer can be pulled outside a little, with growing resistance.
import { keepInside } from "../format/region.ts";
import type { Place, Region } from "../format/types.ts";
import { along, angle, between, length, minus, unit, type Vector, vector } from "../format/vector.ts";

/** From where, and in what direction (length 1). */
export interface Pose {
  readonly position: Vector;
  readonly forward: Vector;
}

/** How far one can be pulled outside: a share of the distance to what is looked at, and radians. */
const GIVE_SHARE = 0.15;
const GIVE_ANGLE = Math.PI / 22;

/** How far something gives way that is pulled by `excess`: as far as it is pulled at first, but never by `most`. */
export function rubber(excess: number, most: number): number {
  return most > 0 ? (excess * most) / (excess + most) : 0;
}

/** The place that a viewer belongs to: the one whose ball is nearest; of several, that which he looks best at. */
export function placeOf(region: Region, pose: Pose): Place {
  const rated = region.places.map((place) => ({
    place,
    away: Math.max(0, length(minus(pose.position, vector(place.position))) - place.reach),
    off: angle(unit(minus(vector(place.focus), pose.position), pose.forward), pose.forward),
  }));
  return rated.reduce((a, b) => (b.away < a.away || (b.away === a.away && b.off < a.off) ? b : a)).place;
}

/** Where a viewer is who is pulled to `pose`: the same inside, held back outside; `strain` is 0 inside and below 1. */
export function softened(region: Region, pose: Pose): Pose & { strain: number } {
  const place = placeOf(region, pose);
  const kept = keepInside(region, pose.position, pose.forward);
  const pull = minus(pose.position, kept.position);
  const out = length(pull);
  const give = GIVE_SHARE * length(minus(vector(place.focus), vector(place.position)));
  const off = angle(kept.forward, pose.forward);
  const strain = Math.max(rubber(out, give) / give, rubber(off, GIVE_ANGLE) / GIVE_ANGLE);
  return {
    position: out > 0 ? along(kept.position, pull, rubber(out, give) / out) : pose.position,
    forward: off > 0 ? between(kept.forward, pose.forward, rubber(off, GIVE_ANGLE) / off) : pose.forward,
    strain,
  };
}

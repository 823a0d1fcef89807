// From where a scene may be looked at, and where it stands in a world with y up: FORMAT.md, section 8. A transform is
// three rows of a turn, times a scale, with a shift.
import {
  AGREEMENT,
  FORGIVEN_DEGREES,
  FORGIVEN_SHARE,
  LEAST_SCALE,
  LEVELLING,
  MOST_SCALE,
  WORLD_TOLERANCE,
} from "../generated/constants.ts";
import type { Camera, Place, Region, Root, World } from "./types.ts";
import { across, along, cross, dot, length, minus, scaled, unit, type Vector, vector } from "./vector.ts";

/** Where a viewer is, world units, and the unit vector along which it looks. */
export interface Viewer {
  position: ArrayLike<number>;
  forward: ArrayLike<number>;
}

/** Who looks from where; vectors are of length 1, positions in world units. */
export interface ViewState {
  position: Vector;
  forward: Vector;
  up: Vector;
  /** Vertical field of view in degrees. */
  fovY: number;
  /** What is nearer is not drawn, world units. */
  near: number;
}

export function cameraOf(view: ViewState, width: number, height: number): Camera {
  const right = cross(view.forward, across(view.up, view.forward));
  const down = cross(view.forward, right);
  const worldToCamera = new Float64Array(16);
  [right, down, view.forward].forEach((axis, line) => {
    worldToCamera.set([...axis, -dot(axis, view.position)], 4 * line);
  });
  worldToCamera[15] = 1;
  const focal = height / 2 / Math.tan((view.fovY * Math.PI) / 360);
  return { width, height, fx: focal, fy: focal, cx: width / 2, cy: height / 2, near: view.near, worldToCamera };
}

/** How far a viewer is beyond the reach of a place, world units, and looks away from its focus more than it may. */
interface Departure {
  distance: number;
  degrees: number;
}

const DEGREES = 180 / Math.PI;

function departureFrom(place: Place, turn: number, { position, forward }: Viewer): Departure {
  const at = vector(position);
  const sizes = [length(minus(place.focus, place.position)), ...at.map(Math.abs)];
  const forgiven = FORGIVEN_SHARE * Math.max(...sizes);
  const beyond = length(minus(at, place.position)) - place.reach;
  const ahead = minus(place.focus, at);
  const distant = length(ahead);
  const cosine = distant <= forgiven ? 1 : dot(ahead, forward) / distant;
  const past = Math.acos(Math.min(Math.max(cosine, -1), 1)) * DEGREES - turn;
  return { distance: beyond > forgiven ? beyond : 0, degrees: past > FORGIVEN_DEGREES ? past : 0 };
}

/** The place from which a viewer departs the least, in distance and then in direction. */
export function nearest(region: Region, viewer: Viewer): { place: Place; departure: Departure } {
  const all = region.places.map((place) => ({ place, departure: departureFrom(place, region.turn, viewer) }));
  return all.reduce((best, one) => {
    const nearer = one.departure.distance - best.departure.distance;
    return nearer < 0 || (nearer === 0 && one.departure.degrees < best.departure.degrees) ? one : best;
  });
}

/** The nearest position that a region allows, and there the direction nearest to `forward`: a wall for cameras. */
export function keepInside(
  region: Region,
  position: ArrayLike<number>,
  forward: ArrayLike<number>,
): { position: Vector; forward: Vector } {
  const { place, departure } = nearest(region, { position, forward });
  let at = vector(position);
  if (departure.distance > 0) {
    const away = minus(at, place.position);
    at = along(place.position, away, place.reach / length(away));
  }
  const inside = { position: at, forward: vector(forward) };
  if (departureFrom(place, region.turn, inside).degrees > 0) {
    const ahead = unit(minus(place.focus, at));
    const angle = region.turn / DEGREES;
    inside.forward = along(scaled(ahead, Math.cos(angle)), across(forward, ahead), Math.sin(angle));
  }
  return inside;
}

/** The region of a package as players take it: where the package tells which way is up, so it is at every place. */
export function levelled({ region, world }: Root): Region {
  if (!world) return region;
  const up = [...upOf(world)];
  return { ...region, places: region.places.map((place) => ({ ...place, up })) };
}

/** Where up is for all of a region, of length 1: the mean of its places' (where they do not agree, that of the first),
 * levelled: the sides of pictures are at right angles to it.
 */
export function upright({ places }: Region): Vector {
  const ups = places.map((place) => unit(vector(place.up)));
  const sides = places.map((place, i) => cross(unit(minus(place.focus, place.position)), ups[i]!));
  const sum = ups.reduce((all, one) => along(all, one));
  let up = length(sum) > AGREEMENT * ups.length ? unit(sum) : ups[0]!;
  for (let step = 0; step < LEVELLING; step++) {
    const tilts = sides.map((side) => dot(side, up) / sides.length);
    up = unit(sides.reduce((sum, side, i) => along(sum, side, -tilts[i]!), up));
  }
  return up;
}

/** The first view, at the first place; `up` is across `forward`. */
export function firstView(region: Region): ViewState {
  const place = region.places[0]!;
  const forward = unit(minus(place.focus, place.position));
  const up = across(upright(region), forward);
  return { position: vector(place.position), forward, up, fovY: region.fov_y, near: region.near };
}

const row = ({ transform }: World, i: number): Vector => vector(transform.slice(4 * i));

export function isSimilarity(world: World): boolean {
  const rows = [row(world, 0), row(world, 1), row(world, 2)] as const;
  const scale = scaleOf(world);
  const near = (product: number, expected: number) => Math.abs(product / scale ** 2 - expected) <= WORLD_TOLERANCE;
  const turned = rows.every((a, i) => rows.every((b, j) => near(dot(a, b), +(i === j))));
  const bounded = scale <= MOST_SCALE * (1 + WORLD_TOLERANCE) && scale >= LEAST_SCALE * (1 - WORLD_TOLERANCE);
  return turned && bounded && dot(cross(rows[0], rows[1]), rows[2]) > 0;
}

export const scaleOf = (world: World): number =>
  (length(row(world, 0)) + length(row(world, 1)) + length(row(world, 2))) / 3;

/** Which way is up in the coordinates of the scene, of length 1. */
export const upOf = (world: World): Vector => unit(row(world, 1));

// A camera that goes round what is looked at, without any page: gestures and keys push it, `step` lets time go by.
import { keepInside, upright, type ViewState } from "../format/region.ts";
import type { Place, Region } from "../format/types.ts";
import {
  along,
  angle,
  between,
  cross,
  dot,
  length,
  minus,
  scaled,
  turned,
  unit,
  type Vector,
  vector,
} from "../format/vector.ts";
import type { CameraPath } from "../play/keyframes.ts";
import type { Stance } from "./address.ts";
import type { Subject } from "./subject.ts";

/** From where, and in what direction (length 1). */
interface Pose {
  readonly position: Vector;
  readonly forward: Vector;
}

/** How the camera is moved, or how fast: radians round the focus, shares of the picture's height, ln of distances. */
export interface Push {
  right?: number;
  up?: number;
  panRight?: number;
  panUp?: number;
  nearer?: number;
}

const NAMES = ["right", "up", "panRight", "panUp", "nearer"] as const;
/** Seconds in which what was pushed comes to rest, and is back behind the wall (to 1/e). */
const REST_S = 0.25;
const REST_REDUCED_S = 0.06;
const BACK_S = 0.12;
const GLIDE_S = 0.45;
/** Slower is at rest: less than a pixel in a second. */
const STILL = 1e-3;
/** The camera never stands on its head: radians between its direction and the horizon. */
const STEEPEST = 1.5;
/** Distances from the focus, of that of the first view. */
const NEAREST = 0.02;
const FARTHEST = 20;
/** Wider than this, the picture is distorted: degrees. */
const WIDEST = 100;
/** A subject that is framed fills this share of the picture. */
const FRAMED = 0.8;
/** Places look at one thing if none of them is turned away from their middle by more, radians. */
const ASIDE = Math.PI / 6;
const NOWHERE: Place = { position: [0, 0, -4], focus: [0, 0, 0], up: [0, -1, 0], reach: 0 };
const FOV_Y = 50;
const NEAR = 0.01;

const aheadOf = ({ position, focus }: Place): Vector => unit(minus(focus, position));

/** The middle of what all places of a region look at, and that region with the middle in place of what each looks at,
 * where viewers look as far aside as before; null: places look at different things.
 */
function middleOf(region: Region): { middle: Vector; walls: Region } | null {
  const { places, turn } = region;
  const middle = places.reduce<Vector>((sum, { focus }) => along(sum, focus, 1 / places.length), [0, 0, 0]);
  const aside = Math.max(...places.map((place) => angle(aheadOf(place), unit(minus(middle, place.position)))));
  const walls = places.map((place) => ({ ...place, focus: [...middle] }));
  return aside < ASIDE ? { middle, walls: { ...region, turn: turn + (aside * 180) / Math.PI, places: walls } } : null;
}

/** A camera about a pivot: the middle of what all places of a region look at, else what the first one does. */
export class Orbit {
  /** Whether viewers may leave the region. */
  free = false;
  held = false;
  /** Whether motion ends at once, as people can ask for. */
  reduced = false;
  /** How far the viewer is pulled out of the region, 0 … 1. */
  strain = 0;
  /** The region as its wall is for viewers who look at its middle. */
  readonly #walls: Region | null;
  #pose: Pose = { position: [0, 0, -4], forward: [0, 0, 1] };
  #up: Vector = vector(NOWHERE.up);
  readonly #first: Place;
  /** The first view, with a focus beside the middle of the subject. */
  readonly #opening: Stance;
  /** What the region says is up, and where viewers begin. */
  readonly #upright: Vector;
  #start: Stance;
  /** What it turns about: what is seen stays as it is where that changes. */
  pivot: Vector = [0, 0, 0];
  readonly #speed: Required<Push> = { right: 0, up: 0, panRight: 0, panUp: 0, nearer: 0 };
  #drive: Push = {};
  #glide: { from: Pose; left: number } | null = null;
  /** Degrees from bottom to top, in the place of the region's. */
  #lens: number | null = null;
  #way: { path: CameraPath; seconds: number } | null = null;

  constructor(readonly region: Region | null = null) {
    this.#first = region ? region.places[0]! : NOWHERE;
    this.#upright = region ? upright(region) : vector(NOWHERE.up);
    const found = region && middleOf(region);
    this.#walls = found?.walls ?? region;
    const [position, ahead] = [vector(this.#first.position), aheadOf(this.#first)];
    const depth = found ? dot(minus(found.middle, position), ahead) : 0;
    this.#opening = { position, focus: depth > 0 ? along(position, ahead, depth) : vector(this.#first.focus) };
    this.#start = this.#opening;
    this.#stand(this.#start);
  }

  reset(): void {
    this.#way = null;
    this.#startGlide();
    this.#stand(this.#start);
  }

  /** From now on, the viewer begins somewhere else, or (null) at the first place of the region; he goes there. */
  begin(stance: Stance | null): void {
    this.#start = stance ?? this.#opening;
    this.reset();
  }

  /** Look at a point, and turn about it. */
  lookAt(point: Vector): void {
    this.#take(point, this.#pose.position, unit(minus(point, this.#pose.position), this.#pose.forward));
  }

  /** Go to where a subject fills a picture of an aspect, without a turn. */
  show({ middle, half }: Subject, aspect: number): void {
    const high = FRAMED * Math.tan((this.#fov(aspect) * Math.PI) / 360);
    const away = half[2] + Math.max(half[0] / aspect, half[1]) / high;
    this.#take(middle, along(middle, this.#pose.forward, -away), this.#pose.forward);
  }

  #take(pivot: Vector, position: Vector, forward: Vector): void {
    this.stop();
    this.#startGlide();
    this.pivot = pivot;
    this.#pose = { position, forward };
  }

  /** Go along a path that is read, given what is up and a field of view, until somebody takes the camera. */
  follow(read: (up: Vector, fovY: number) => CameraPath): void {
    this.#way = { path: read(this.#upright, this.region?.fov_y ?? FOV_Y), seconds: 0 };
    this.#goOn(0);
  }

  #goOn(seconds: number): void {
    const way = this.#way!;
    way.seconds += seconds;
    const view = way.path.at(way.seconds);
    const [position, focus, up] = [0, 3, 6].map((i) => vector(view.slice(i))) as [Vector, Vector, Vector];
    this.#stand({ position, focus, up: unit(up) });
    this.#lens = view[9];
  }

  turnOver(): void {
    this.#way = null;
    this.#up = scaled(this.#up, -1);
  }

  get stance(): Stance {
    const { position, forward } = this.#pose;
    const focus = along(position, forward, this.#depth);
    return length(minus(this.#up, this.#upright)) > 0 ? { position, focus, up: this.#up } : { position, focus };
  }

  #stand(stance: Stance): void {
    const { position, focus, up } = stance;
    this.#pose = { position, forward: unit(minus(focus, position)) };
    this.pivot = focus;
    this.#up = up ?? this.#upright;
    this.#lens = null;
    this.#halt();
    this.strain = 0;
  }

  setFree(free: boolean): void {
    if (this.free !== free) this.#startGlide();
    this.free = free;
  }

  get moving(): boolean {
    return this.#glide !== null || NAMES.some((name) => this.#speed[name] !== 0);
  }

  /** Whether the viewer is where nobody promises anything. */
  get outside(): boolean {
    return this.#departure()?.far ?? false;
  }

  /** The nearest pose in the region, and the way there: world units, radians; `far`: it can be seen. */
  #departure(): { inside: Pose; out: number; off: number; far: boolean } | null {
    if (!this.#walls) return null;
    const { position, forward } = this.#pose;
    const inside = insideOf(this.#walls, this.#pose, this.pivot);
    const [out, off] = [length(minus(position, inside.position)), angle(forward, inside.forward)];
    return { inside, out, off, far: out > STILL * length(minus(inside.position, this.pivot)) || off > STILL };
  }

  stop(): void {
    this.#way = null;
    this.#halt();
  }

  #halt(): void {
    for (const name of NAMES) this.#speed[name] = 0;
  }

  move(push: Push): void {
    if (push.right || push.up) this.#turn(push.right ?? 0, push.up ?? 0);
    if (push.panRight || push.panUp) this.#shift(push.panRight ?? 0, push.panUp ?? 0);
    if (push.nearer) this.#approach(push.nearer);
  }

  nudge(push: Push): void {
    this.#way = null;
    for (const name of NAMES) this.#speed[name] += (push[name] ?? 0) / this.#rest;
  }

  /** Go on at a speed a second, to come to rest by itself. */
  fling(speed: Push): void {
    if (!this.reduced) for (const name of NAMES) this.#speed[name] = speed[name] ?? 0;
  }

  /** Go at a speed a second as long as it is driven, by keys that are held down. */
  drive(speed: Push): void {
    this.#drive = speed;
    if (Object.keys(speed).length > 0) this.#way = null;
    for (const name of NAMES) if (speed[name]) this.#speed[name] = speed[name]!;
  }

  /** Let `seconds` go by, and `played` seconds of the scene. True: the view has changed. */
  step(seconds: number, played = 0): boolean {
    if (this.#way) {
      this.#goOn(this.reduced ? 0 : played);
      return played > 0;
    }
    let moved = this.#advance(seconds);
    if (!this.held && this.#ease(seconds)) moved = true;
    if (this.#glide) {
      this.#glide.left -= seconds / GLIDE_S;
      if (this.#glide.left <= 0) this.#glide = null;
      moved = true;
    }
    return moved;
  }

  /** The view in a picture of an aspect: as high as what the package was judged by; at least as wide as that is high, or
   * wide. The poster is shown by the same rule (style.css).
   */
  view(aspect: number): ViewState {
    const { position, forward } = this.pose();
    const up = unit(cross(unit(cross(forward, this.#up), [1, 0, 0]), forward));
    return { position, forward, up, fovY: this.#fov(aspect), near: this.region?.near ?? NEAR };
  }

  pose(): Pose {
    const walls = this.free ? null : this.#walls;
    const pose = walls ? softened(walls, this.#pose, this.pivot) : { ...this.#pose, strain: 0 };
    this.strain = pose.strain;
    if (!this.#glide) return pose;
    const { from, left } = this.#glide;
    const share = left * left * (3 - 2 * left);
    const [here, there] = [pose.position, from.position].map((point) => minus(point, this.pivot)) as [Vector, Vector];
    const size = length(here) + share * (length(there) - length(here));
    const position = along(this.pivot, between(unit(here), unit(there), share), size);
    return { position, forward: between(pose.forward, from.forward, share) };
  }

  /** How far ahead the pivot is: beside the viewer, as if it were in front of him. */
  get #depth(): number {
    const way = minus(this.pivot, this.#pose.position);
    const depth = dot(way, this.#pose.forward);
    return depth > 0 ? depth : length(way);
  }

  get #rest(): number {
    return this.reduced ? REST_REDUCED_S : REST_S;
  }

  #startGlide(): void {
    this.#glide = this.reduced ? null : { from: this.pose(), left: 1 };
  }

  #fov(aspect: number): number {
    const { fov_y, width, height } = this.region ?? { fov_y: FOV_Y, width: 16, height: 9 };
    const fov = this.#lens ?? fov_y;
    const least = Math.min(1, width / height);
    if (aspect >= least) return fov;
    const wide = (2 * Math.atan((Math.tan((fov * Math.PI) / 360) * least) / aspect) * 180) / Math.PI;
    return Math.max(fov, Math.min(wide, WIDEST));
  }

  #turn(right: number, up: number): void {
    const { position, forward } = this.#pose;
    const pivot = this.pivot;
    const tilt = Math.asin(Math.max(-1, Math.min(1, dot(forward, this.#up))));
    const wanted = tilt - up;
    const rise = up > 0 ? Math.max(wanted, Math.min(tilt, -STEEPEST)) : Math.min(wanted, Math.max(tilt, STEEPEST));
    const axis = unit(cross(forward, this.#up), [1, 0, 0]);
    const go = (a: Vector) => turned(turned(a, axis, rise - tilt), this.#up, right);
    this.#pose = { position: along(pivot, go(minus(position, pivot))), forward: unit(go(forward)) };
  }

  #shift(right: number, up: number): void {
    const { position, forward } = this.#pose;
    const side = unit(cross(forward, this.#up), [1, 0, 0]);
    const half = (this.#fov(1) * Math.PI) / 360;
    const high = 2 * Math.tan(half) * this.#depth;
    const way = along(along([0, 0, 0], side, right * high), cross(side, forward), up * high);
    this.#pose = { position: along(position, way), forward };
    const inSight = angle(forward, unit(minus(this.pivot, this.#pose.position), forward)) < half;
    if (!inSight) this.pivot = along(this.pivot, way);
  }

  #approach(nearer: number): void {
    const { position, forward } = this.#pose;
    const full = length(minus(vector(this.#first.position), vector(this.#first.focus)));
    const away = this.#depth;
    const wanted = Math.max(NEAREST * full, Math.min(away * Math.exp(-nearer), FARTHEST * full));
    this.#pose = { position: along(position, forward, away - wanted), forward };
  }

  #advance(seconds: number): boolean {
    const push: Push = {};
    let moved = false;
    for (const name of NAMES) {
      const speed = this.#speed[name];
      if (!speed) continue;
      moved = true;
      const driven = this.#drive[name];
      push[name] = driven ? driven * seconds : speed * this.#rest * (1 - Math.exp(-seconds / this.#rest));
      const slower = driven ?? speed * Math.exp(-seconds / this.#rest);
      this.#speed[name] = Math.abs(slower) < STILL ? 0 : slower;
    }
    if (moved) this.move(push);
    return moved;
  }

  #ease(seconds: number): boolean {
    const departure = this.free ? null : this.#departure();
    if (!departure || (departure.out === 0 && departure.off === 0)) return false;
    const { position, forward } = this.#pose;
    const { inside, far } = departure;
    const share = 1 - Math.exp(-seconds / BACK_S);
    const way = minus(inside.position, position);
    const pose = { position: along(position, way, share), forward: between(forward, inside.forward, share) };
    this.#pose = far ? pose : inside;
    return true;
  }
}

// The soft wall of the viewing region: a viewer can be pulled outside a little, with growing resistance.

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

/** A direction from a place as it is from another one: the pivot is seen at the same place of the picture. */
const aimed = (forward: Vector, from: Vector, to: Vector, pivot: Vector): Vector =>
  length(minus(from, to)) === 0
    ? forward
    : unit(along(along(forward, unit(minus(pivot, to))), unit(minus(pivot, from)), -1), forward);

function insideOf(region: Region, { position, forward }: Pose, pivot: Vector): Pose {
  const at = keepInside(region, position, forward).position;
  return keepInside(region, at, aimed(forward, position, at, pivot));
}

/** Where a viewer is who is pulled to `pose`: the same inside, held back outside, with the pivot where it was in the
 * picture; `strain` is 0 inside and below 1.
 */
export function softened(region: Region, pose: Pose, pivot: Vector): Pose & { strain: number } {
  const place = placeOf(region, pose);
  const inside = insideOf(region, pose, pivot);
  const pull = minus(pose.position, inside.position);
  const out = length(pull);
  const give = GIVE_SHARE * length(minus(vector(place.focus), vector(place.position)));
  const position = out > 0 ? along(inside.position, pull, rubber(out, give) / out) : pose.position;
  const forward = aimed(pose.forward, pose.position, position, pivot);
  const allowed = out > 0 ? aimed(inside.forward, inside.position, position, pivot) : inside.forward;
  const off = angle(allowed, forward);
  return {
    position,
    forward: off > 0 ? between(allowed, forward, rubber(off, GIVE_ANGLE) / off) : forward,
    strain: Math.max(rubber(out, give) / give, rubber(off, GIVE_ANGLE) / GIVE_ANGLE),
  };
}

// Vectors of three numbers: positions in world units, or directions.

export type Vector = readonly [number, number, number];
type Three = ArrayLike<number>;

export const vector = (a: Three): Vector => [a[0]!, a[1]!, a[2]!];
export const along = (a: Three, b: Three, t = 1): Vector => [a[0]! + t * b[0]!, a[1]! + t * b[1]!, a[2]! + t * b[2]!];
export const minus = (a: Three, b: Three): Vector => along(a, b, -1);
export const scaled = (a: Three, t: number): Vector => [t * a[0]!, t * a[1]!, t * a[2]!];
export const dot = (a: Three, b: Three): number => a[0]! * b[0]! + a[1]! * b[1]! + a[2]! * b[2]!;
export const length = (a: Three): number => Math.hypot(a[0]!, a[1]!, a[2]!);

export function cross(a: Three, b: Three): Vector {
  return [a[1]! * b[2]! - a[2]! * b[1]!, a[2]! * b[0]! - a[0]! * b[2]!, a[0]! * b[1]! - a[1]! * b[0]!];
}

/** `a` with length 1; `otherwise` where `a` has no direction. */
export function unit(a: Three, otherwise: Vector = [0, 0, 1]): Vector {
  const size = length(a);
  return size > 0 ? [a[0]! / size, a[1]! / size, a[2]! / size] : otherwise;
}

/** The part of `a` at a right angle to the unit vector `axis`, of length 1; any such vector where there is none. */
export function across(a: Three, axis: Three): Vector {
  const side = along(a, axis, -dot(a, axis));
  if (length(side) > 1e-12 * length(a)) return unit(side); // less than that is rounding
  const sizes = vector(axis).map(Math.abs);
  const least = sizes.indexOf(Math.min(...sizes));
  return across(
    [0, 1, 2].map((i) => (i === least ? 1 : 0)),
    axis,
  );
}

/** The angle between two directions of length 1, radians; exact near 0, where the arc cosine is not. */
export function angle(a: Vector, b: Vector): number {
  return Math.atan2(length(cross(a, b)), dot(a, b));
}

/** `a` turned by `radians` about `axis`, of length 1, to the right-hand side (Rodrigues). */
export function turned(a: Vector, axis: Vector, radians: number): Vector {
  const cosine = Math.cos(radians);
  const flat = along(scaled(a, cosine), cross(axis, a), Math.sin(radians));
  return along(flat, axis, dot(axis, a) * (1 - cosine));
}

/** A direction between two directions of length 1: `share` of the angle from `a` to `b`. */
export function between(a: Vector, b: Vector, share: number): Vector {
  const axis = cross(a, b);
  return length(axis) > 0 ? unit(turned(a, unit(axis), angle(a, b) * share)) : share < 1 ? a : b;
}

/** Whether a direction and what is up in it make a view: the sine of the angle between them is more than rounding. */
export const makesView = (ahead: Vector, up: Vector): boolean =>
  length(ahead) > 0 && length(up) > 0 && length(cross(unit(ahead), unit(up))) > 1e-6;

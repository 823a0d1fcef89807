// Where a scene stands around somebody who sits down at its first view with a headset on, and what his eyes see.
//
// A room is what WebXR calls a "local" space: metres, y up, its origin at the eyes of whom sat down, who looks along -z.
// Matrices of WebXR are (16) column by column.
import { cameraOf, firstView, levelled, scaleOf, upright, type ViewState } from "../format/region.ts";
import type { Camera, Root } from "../format/types.ts";
import { across, along, cross, dot, length, minus, scaled, type Vector } from "../format/vector.ts";

/** How far away the subject is where nobody knows how long a unit is, metres. */
const COMFORTABLE_M = 1.5;
/** Sine of the angle from which on a first view looks far up or down. */
const STEEP = Math.SQRT1_2;

export interface Seat {
  /** The origin of the room in the scene, world units. */
  origin: Vector;
  /** The directions x, y and z of the room in the scene, of length 1. */
  axes: readonly [Vector, Vector, Vector];
  metre: number; // world units
  near: number;
}

/** The seat at the first view of a package: upright, in real size where the package tells it.
 *
 * Where nobody told which way is up and the first view looks far up or down, it is what is straight ahead.
 */
export function seatOf(root: Root): Seat {
  const region = levelled(root);
  const view = firstView(region);
  const guess = upright(region);
  const up = !root.world && Math.abs(dot(view.forward, guess)) > STEEP ? view.up : guess;
  const back = scaled(across(view.forward, up), -1);
  const distance = length(minus(region.places[0].focus, view.position));
  const metre = root.world?.metric ? 1 / scaleOf(root.world) : distance / COMFORTABLE_M;
  return { origin: view.position, axes: [cross(up, back), up, back], metre, near: region.near };
}

export function viewFrom({ origin, axes, metre, near }: Seat, pose: Float32Array): ViewState {
  const turned = (at: number): Vector =>
    axes.reduce<Vector>((sum, axis, i) => along(sum, axis, pose[at + i]), [0, 0, 0]);
  return {
    position: along(origin, turned(12), metre),
    forward: scaled(turned(8), -1),
    up: turned(4),
    fovY: 90, // an eye has a lens of its own
    near,
  };
}

/** The camera of an eye, whose axis need not be in the middle of its picture. */
export function eyeCamera(seat: Seat, pose: Float32Array, lens: Float32Array, width: number, height: number): Camera {
  return {
    ...cameraOf(viewFrom(seat, pose), width, height),
    fx: (lens[0] * width) / 2,
    fy: (lens[5] * height) / 2,
    cx: ((1 - lens[8]) * width) / 2,
    cy: ((1 + lens[9]) * height) / 2,
  };
}

// What a viewer sees and is expected to see: airgs_codec/play/sight.py, number by number.
//
// A player knows how its viewer stands and moved until now. It expects the movement to go on and to die down, so that
// after t seconds DECAY_S · (1 − exp(−t / DECAY_S)) seconds of it have passed. Measured in docs/results/tiles.md.
import type { Camera, Tile } from "../format/types.ts";
import { across, along, cross, dot, length, minus, scaled, turned, unit, type Vector } from "../format/vector.ts";
import { BEFORE_S, CORNERS, DECAY_S, SMALL_TURN } from "../generated/constants.ts";

const DEGREES = 180 / Math.PI;

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

/** The camera of a picture of `width` × `height` pixels. */
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

/** Where the camera of a matrix (16, row by row) stands. */
function positionOf(m: Float64Array): Vector {
  const axis = (i: number) => -(m[i] * m[3] + m[4 + i] * m[7] + m[8 + i] * m[11]);
  return [axis(0), axis(1), axis(2)];
}

export interface Velocity {
  /** Rotation vector in camera axes, radians a second. */
  turn: Vector;
  shift: Vector;
}

/** The steady movement that leads from one view to another in a time. */
export function velocityOf(before: Camera, here: Camera, seconds = BEFORE_S): Velocity {
  const [a, b] = [before.worldToCamera, here.worldToCamera];
  const entry = (i: number, j: number) =>
    b[4 * i] * a[4 * j] + b[4 * i + 1] * a[4 * j + 1] + b[4 * i + 2] * a[4 * j + 2];
  const cosine = (entry(0, 0) + entry(1, 1) + entry(2, 2) - 1) / 2;
  const angle = Math.acos(Math.max(-1, Math.min(1, cosine)));
  const axis: Vector = [entry(2, 1) - entry(1, 2), entry(0, 2) - entry(2, 0), entry(1, 0) - entry(0, 1)];
  const turn = scaled(axis, angle < SMALL_TURN ? 0.5 : angle / (2 * Math.sin(angle)));
  return { turn: scaled(turn, 1 / seconds), shift: scaled(minus(positionOf(b), positionOf(a)), 1 / seconds) };
}

/** Expects the view some seconds later of a viewer who sees and moves like this. */
export function expected(view: Camera, { turn, shift }: Velocity, aheadS: number): Camera {
  const passedS = DECAY_S * (1 - Math.exp(-Math.max(0, aheadS) / DECAY_S));
  const m = view.worldToCamera;
  const position = along(positionOf(m), shift, passedS);
  const worldToCamera = new Float64Array(16);
  for (let j = 0; j < 3; j++) {
    const column = turned([m[j], m[4 + j], m[8 + j]], unit(turn), length(turn) * passedS);
    for (let i = 0; i < 3; i++) {
      worldToCamera[4 * i + j] = column[i];
      worldToCamera[4 * i + 3] -= column[i] * position[j];
    }
  }
  worldToCamera[15] = 1;
  return { ...view, worldToCamera };
}

/** Parts of space, P of them, each as CORNERS points on every axis of a box, its corners among them. */
export class Boxes {
  /** Of each box (3 · CORNERS³), world units. */
  readonly #points: readonly Float64Array[];

  constructor(boxes: readonly Pick<Tile, "low" | "high">[]) {
    this.#points = boxes.map(({ low, high }) => {
      const points: number[] = [];
      const at = (axis: number, n: number) => low[axis] + ((high[axis] - low[axis]) * n) / (CORNERS - 1);
      for (let n = 0; n < CORNERS ** 3; n++) {
        const [i, j, k] = [n % CORNERS, Math.floor(n / CORNERS) % CORNERS, Math.floor(n / CORNERS ** 2)];
        points.push(at(0, i), at(1, j), at(2, k));
      }
      return Float64Array.from(points);
    });
  }

  /** (P) by how many degrees the sides of a picture must be moved out for a point of a box to be in it. Negative where
   * one is in the picture: how far inside of its sides the innermost one is.
   */
  degreesOff({ worldToCamera: m, width, height, fx, fy }: Camera): number[] {
    const [across, down] = [Math.atan(width / 2 / fx), Math.atan(height / 2 / fy)];
    return this.#points.map((points) => {
      let least = Number.POSITIVE_INFINITY;
      for (let p = 0; p < points.length; p += 3) {
        const [a, b, c] = [points[p], points[p + 1], points[p + 2]];
        const x = m[0] * a + m[1] * b + m[2] * c + m[3];
        const y = m[4] * a + m[5] * b + m[6] * c + m[7];
        const z = m[8] * a + m[9] * b + m[10] * c + m[11];
        const beside = Math.abs(Math.atan2(x, z)) - across;
        const above = Math.abs(Math.atan2(y, Math.hypot(x, z))) - down;
        least = Math.min(least, Math.max(beside, above));
      }
      return DEGREES * least;
    });
  }
}

/** A viewer over time, as far as it matters: where he stands, and stood a moment ago. */
export class Watcher {
  /** By time; the last one before BEFORE_S and those since. */
  #views: { atS: number; view: ViewState }[] = [];
  #size = { width: 1, height: 1 };

  /** He looks like this from now on. */
  look(view: ViewState, nowS: number): void {
    this.#views.push({ atS: nowS, view });
    while (this.#views.length > 1 && this.#views[1].atS <= nowS - BEFORE_S) this.#views.shift();
  }

  /** The pixels of his pictures, whose shape matters. */
  resize(width: number, height: number): void {
    this.#size = { width, height };
  }

  /** The view at a moment, not earlier than BEFORE_S ago; null: nobody looks yet. */
  at(nowS: number): Camera | null {
    const last = this.#views.filter(({ atS }) => atS <= nowS).at(-1) ?? this.#views[0];
    return last ? cameraOf(last.view, this.#size.width, this.#size.height) : null;
  }
}

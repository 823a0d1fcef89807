// What is under a pointer, and where the subject is: from what a picture shows of each Gaussian.
import { along, dot, length, minus, type Vector, vector } from "../format/vector.ts";
import type { Drawn } from "../render/renderer.ts";

/** The middle of what is seen of a subject, and half of its size to the right, down and ahead, world units. */
export interface Subject {
  readonly middle: Vector;
  readonly half: Vector;
}

/** The subject is nearer to what is looked at than this share of the viewer's distance; looked for so many times. */
const NEAR = 0.5;
const LOOKS = 4;
/** More Gaussians are not needed to find it: of many, some are left out. */
const MOST = 50_000;
/** Half of a size, in standard deviations. */
const HALF = 2;

/** The number that 16 bits say as a half float. */
function halfFloat(bits: number): number {
  const [sign, exponent, fraction] = [bits >> 15 ? -1 : 1, (bits >> 10) & 31, bits & 1023];
  return sign * (exponent ? 2 ** (exponent - 15) * (1 + fraction / 1024) : 2 ** -24 * fraction);
}

/** Calls `take` with where each Gaussian in a picture is in `firsts` and `seconds`, or each `step`-th, and its depth. */
function forEach({ seconds }: Drawn, take: (at: number, depth: number) => void, step = 1): void {
  const words = new Uint32Array(seconds.buffer);
  for (let at = 0; at < seconds.length; at += 4 * step) {
    if (words[at + 1]) take(at, 2 ** halfFloat(words[at + 3] >>> 16));
  }
}

/** What is to the right, down and ahead of a camera, in world units. */
function placed({ worldToCamera: m }: Drawn["camera"], by: Vector): Vector {
  const axis = (i: number): Vector => [m[4 * i], m[4 * i + 1], m[4 * i + 2]];
  return by.reduce<Vector>((sum, step, i) => along(sum, axis(i), step - m[4 * i + 3]), [0, 0, 0]);
}

/** The point at (x, y), shares of the picture, behind which less than half of the light is seen; null: there is none. */
export function pointAt(drawn: Drawn, x: number, y: number): Vector | null {
  const { firsts, seconds, camera } = drawn;
  const [px, py] = [x * camera.width, y * camera.height];
  const hit: { depth: number; alpha: number }[] = [];
  forEach(drawn, (at, depth) => {
    const down = py - firsts[at + 1];
    const right = px - firsts[at] - seconds[at] * down;
    const far = (right / firsts[at + 2]) ** 2 + (down / firsts[at + 3]) ** 2;
    if (far < 1) hit.push({ depth, alpha: Math.exp(seconds[at + 1] * (1 - far)) / 255 });
  });
  let clear = 1;
  const stops = ({ alpha }: { alpha: number }) => {
    clear *= 1 - alpha;
    return clear < 0.5;
  };
  const depth = hit.sort((a, b) => a.depth - b.depth).find(stops)?.depth;
  const { cx, cy, fx, fy } = camera;
  return depth ? placed(camera, [((px - cx) / fx) * depth, ((py - cy) / fy) * depth, depth]) : null;
}

/** What is about a point, as far as it is in the picture, by area and opacity; null: nothing is. */
export function subjectAt(drawn: Drawn, about: Vector): Subject | null {
  const { firsts, seconds, camera } = drawn;
  const { worldToCamera: m, cx, cy, fx, fy } = camera;
  let middle = [0, 4, 8].map((i) => dot([m[i], m[i + 1], m[i + 2]], about) + m[i + 3]) as unknown as Vector;
  const most = NEAR * length(middle);
  const step = Math.ceil(seconds.length / 4 / MOST);
  let half = middle;
  for (let look = 0; look < LOOKS; look++) {
    const [sums, squares] = [new Float64Array(4), new Float64Array(3)]; // of the ways to the middle, and of weights
    const take = (at: number, depth: number) => {
      const way = minus([((firsts[at] - cx) / fx) * depth, ((firsts[at + 1] - cy) / fy) * depth, depth], middle);
      if (!(length(way) < most)) return;
      const weight = firsts[at + 2] * firsts[at + 3] * Math.exp(seconds[at + 1]) * depth ** 2;
      sums[3] += weight;
      for (let axis = 0; axis < 3; axis++) {
        sums[axis] += weight * way[axis];
        squares[axis] += weight * way[axis] ** 2;
      }
    };
    forEach(drawn, take, step);
    if (!(sums[3] > 0)) return null;
    const mean = vector(sums.map((one) => one / sums[3]));
    half = vector(squares.map((one, i) => HALF * Math.sqrt(Math.max(0, one / sums[3] - mean[i] ** 2))));
    middle = along(middle, mean);
  }
  return { middle: placed(camera, middle), half };
}

// What is under a pointer, and where the subject is: from what a picture shows of each Gaussian.
import { along, dot, length, minus, type Vector } from "../format/vector.ts";
import type { Drawn } from "../render/renderer.ts";

/** The middle of what is seen of a subject, and half of its size to the right, down and ahead, world units. */
export interface Subject {
  readonly middle: Vector;
  readonly half: Vector;
}

/** The subject is nearer to what is looked at than this share of the viewer's distance; looked for so many times. */
const NEAR = 0.5;
const LOOKS = 4;
const BINS = 512;
/** Of what is seen, left out at both ends of each axis. */
const LEFT_OUT = 0.02;
const ALPHA_MAX = 0.99;

/** The number that 16 bits say as a half float. */
function half(bits: number): number {
  const [sign, exponent, fraction] = [bits >> 15 ? -1 : 1, (bits >> 10) & 31, bits & 1023];
  return sign * (exponent ? 2 ** (exponent - 15) * (1 + fraction / 1024) : 2 ** -24 * fraction);
}

/** Calls `take` with where each Gaussian in a picture is in `firsts` and `seconds`, and its depth, world units. */
function forEach({ seconds }: Drawn, take: (at: number, depth: number) => void): void {
  const words = new Uint32Array(seconds.buffer);
  for (let at = 0; at < seconds.length; at += 4) if (words[at + 1]) take(at, 2 ** half(words[at + 3] >>> 16));
}

/** The axes of a camera, world units: to the right, down, ahead; and where it is. */
function frameOf({ worldToCamera: m }: Drawn["camera"]): { axes: Vector[]; eye: Vector } {
  const axes = [0, 4, 8].map((i): Vector => [m[i], m[i + 1], m[i + 2]]);
  const eye = axes.reduce<Vector>((sum, axis, i) => along(sum, axis, -m[4 * i + 3]), [0, 0, 0]);
  return { axes, eye };
}

const placed = (axes: readonly Vector[], from: Vector, by: Vector): Vector =>
  axes.reduce((sum, axis, i) => along(sum, axis, by[i]), from);

/** The point at (x, y), shares of the picture, behind which less than half of the light is seen; null: there is none. */
export function pointAt(drawn: Drawn, x: number, y: number): Vector | null {
  const { firsts, seconds, camera } = drawn;
  const [px, py] = [x * camera.width, y * camera.height];
  const hit: { depth: number; alpha: number }[] = [];
  forEach(drawn, (at, depth) => {
    const down = py - firsts[at + 1];
    const right = px - firsts[at] - seconds[at] * down;
    const far = (right / firsts[at + 2]) ** 2 + (down / firsts[at + 3]) ** 2;
    if (far < 1) hit.push({ depth, alpha: Math.min(ALPHA_MAX, Math.exp(seconds[at + 1] * (1 - far)) / 255) });
  });
  let clear = 1;
  for (const { depth, alpha } of hit.sort((a, b) => a.depth - b.depth)) {
    clear *= 1 - alpha;
    if (clear > 0.5) continue;
    const { axes, eye } = frameOf(camera);
    return placed(axes, eye, [((px - camera.cx) / camera.fx) * depth, ((py - camera.cy) / camera.fy) * depth, depth]);
  }
  return null;
}

/** What is about a point, as far as it is in the picture: between the ends of most of it, by area and opacity. */
export function subjectAt(drawn: Drawn, about: Vector): Subject | null {
  const { firsts, seconds, camera } = drawn;
  const { axes, eye } = frameOf(camera);
  const most = NEAR * length(minus(about, eye));
  let middle = axes.map((axis) => dot(axis, minus(about, eye))) as unknown as Vector;
  let size: Vector | null = null;
  for (let look = 0; look < LOOKS; look++) {
    const bins = axes.map(() => new Float64Array(BINS));
    forEach(drawn, (at, depth) => {
      const x = ((firsts[at] - camera.cx) / camera.fx) * depth - middle[0];
      const y = ((firsts[at + 1] - camera.cy) / camera.fy) * depth - middle[1];
      const z = depth - middle[2];
      if (!(x * x + y * y + z * z < most * most)) return;
      const weight = firsts[at + 2] * firsts[at + 3] * Math.min(1, Math.exp(seconds[at + 1]) / 255);
      for (const [axis, value] of [x, y, z].entries()) {
        bins[axis][Math.floor((value / most + 1) * (BINS / 2))] += weight;
      }
    });
    const ends = bins.map(endsOf);
    if (ends.includes(null)) return null;
    const pairs = ends as [number, number][];
    middle = along(
      middle,
      pairs.map(([low, high]) => ((low + high) / 2) * most),
    );
    size = pairs.map(([low, high]) => ((high - low) / 2) * most) as unknown as Vector;
  }
  return { middle: placed(axes, eye, middle), half: size! };
}

/** Between which shares of −1 … 1 most of a weight is; null: there is none. */
function endsOf(bins: Float64Array): [number, number] | null {
  const whole = bins.reduce((sum, one) => sum + one);
  if (!(whole > 0)) return null;
  const until = (share: number): number => {
    let [i, sum] = [0, bins[0]];
    while (sum < share * whole && i < BINS - 1) sum += bins[++i];
    return (2 * (i + 0.5)) / BINS - 1;
  };
  return [until(LEFT_OUT), until(1 - LEFT_OUT)];
}

// Camera paths: what a camera does over time, as keyframes in JSON, which docs/browser.md shows: not those of a
// package. The ten values of a view are position, focus, up and fov_y, degrees.
import { makesView, minus, unit, type Vector, vector } from "../format/vector.ts";

const MOST_DEGREES = 170;
const KNOWN = ["t", "position", "focus", "up", "fov_y", "name"];

const LONGEST_MS = 5000;

type Row = readonly number[];
type Fields = Readonly<Record<string, unknown>>;

/** A line through K keyframes: at each the camera goes the way from the one before to the one after it (Catmull and Rom
 * 1974); at both ends it goes straight on, or, where the last is the first again, round.
 */
export class CameraPath {
  /** (K, 10) of the values, a second. */
  readonly #speeds: readonly Row[];

  constructor(
    /** (K) ascending from 0, seconds. */
    readonly times: Row,
    readonly values: readonly Row[], // (K, 10)
    readonly loop: boolean,
  ) {
    const last = times.length - 1;
    const closed = loop && last > 0 && values[0].every((x, i) => x === values[last][i]);
    this.#speeds = values.map((_, k) => {
      const [a, b] = closed && k % last === 0 ? [last - 1, 1] : [Math.max(0, k - 1), Math.min(last, k + 1)];
      const seconds = times[b] - times[a] + (b < a ? this.duration : 0);
      return values[b].map((x, i) => (seconds > 0 ? (x - values[a][i]) / seconds : 0));
    });
  }

  get duration(): number {
    return this.times[this.times.length - 1];
  }

  /** (10) the view after some seconds; after its end a loop begins again, and any other path stays there. */
  at(seconds: number): Row {
    const { times, values, duration } = this;
    if (duration === 0) return values[0];
    const within = this.loop ? seconds % duration : Math.max(0, Math.min(seconds, duration));
    let k = times.length - 2;
    while (k > 0 && times[k] > within) k--;
    const span = times[k + 1] - times[k];
    const s = (within - times[k]) / span;
    const bend = s * s * (3 - 2 * s);
    const [leaving, coming] = [span * s * (1 - s) ** 2, span * s * s * (s - 1)];
    const [from, to] = [this.#speeds[k], this.#speeds[k + 1]];
    return values[k].map((x, i) => x + bend * (values[k + 1][i] - x) + leaving * from[i] + coming * to[i]);
  }
}

/** A function that reads the camera path at an address, given what is up and the field of view where it says neither.
 *
 * Throws TypeError or SyntaxError where there is none, and the function Error.
 */
export async function fetchCameraPath(address: string): Promise<(up: Vector, fovY: number) => CameraPath> {
  const response = await fetch(address, { signal: AbortSignal.timeout(LONGEST_MS) });
  if (!response.ok) throw new TypeError(`${address}: HTTP ${response.status}`);
  const data: Fields = await response.json();
  return (up, fovY) => readCameraPath(data, up, fovY);
}

/** The camera path in JSON; `up` and `fovY`, degrees, are those of keyframes without. Throws Error. */
export function readCameraPath(data: Fields, up: Vector, fovY: number): CameraPath {
  if (data.camera_path) {
    const pictures = listOf(data.camera_path).map((one, number) => picture(number, one, Number(data.fps)));
    return pathOf(pictures, data.is_cycle);
  }
  return pathOf(
    listOf(data.keyframes).map((one, number) => keyframe(number, one, up, fovY)),
    data.loop,
  );
}

function listOf(value: unknown): readonly Fields[] {
  if (!Array.isArray(value)) throw new Error("expected keyframes, or nerfstudio's camera_path");
  return value;
}

function keyframe(number: number, frame: Fields, up: Vector, fovY: number): Row {
  const where = `keyframe ${number}`;
  const unknown = Object.keys(frame).filter((name) => !KNOWN.includes(name));
  if (unknown.length > 0) throw new Error(`${where} has ${unknown.sort().join(", ")}, which means nothing`);
  const vectors = [frame.position, frame.focus, frame.up ?? up];
  if (vectors.some((one) => !Array.isArray(one) || one.length !== 3))
    throw new Error(`${where} has a vector that is not three numbers`);
  return checked(where, [frame.t, ...vectors.flat(), frame.fov_y ?? fovY]);
}

/** One entry a picture: 16 numbers of an OpenGL camera-to-world matrix row by row, and degrees from bottom to top. */
function picture(number: number, entry: Fields, fps: number): Row {
  const m = [entry.camera_to_world].flat(2) as number[];
  if (m.length !== 16) throw new Error(`picture ${number} has a matrix that is not 16 numbers`);
  const position = [m[3], m[7], m[11]];
  const focus = [m[3] - m[2], m[7] - m[6], m[11] - m[10]];
  return checked(`picture ${number}`, [number / fps, ...position, ...focus, m[1], m[5], m[9], entry.fov]);
}

/** Numbers that make a camera, with `up` of length 1. */
function checked(where: string, row: readonly unknown[]): Row {
  if (!row.every(Number.isFinite)) throw new Error(`${where} has what is no finite number`);
  const numbers = row as Row;
  const [position, focus, up] = [1, 4, 7].map((i) => vector(numbers.slice(i))) as [Vector, Vector, Vector];
  const [ahead, fovY] = [minus(focus, position), numbers[10]];
  if (!makesView(ahead, up)) throw new Error(`${where} looks nowhere, or along what is up`);
  if (!(0 < fovY && fovY <= MOST_DEGREES))
    throw new Error(`${where} has a fov_y of ${fovY}, expected more than 0 and at most ${MOST_DEGREES} degrees`);
  return [numbers[0], ...position, ...focus, ...unit(up), fovY];
}

function pathOf(rows: readonly Row[], loop: unknown = false): CameraPath {
  if (rows.length === 0) throw new Error("there is no keyframe");
  if (typeof loop !== "boolean") throw new Error(`loop is true or false, got ${JSON.stringify(loop)}`);
  if (rows[0][0] !== 0 || rows.some(([t], k) => k > 0 && !(t > rows[k - 1][0])))
    throw new Error("the times of keyframes begin at 0 and ascend");
  const times = rows.map(([t]) => t);
  return new CameraPath(
    times,
    rows.map((row) => row.slice(1)),
    loop,
  );
}

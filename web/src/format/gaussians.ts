// Codes to Gaussians on the CPU: FORMAT.md, section 5. It is what shaders are tested against, and what adapters to
// other renderers feed. N rows of a group, n rows of a key tier or a level, C colour channels.
import { KEY_AT, OPACITY_MARGIN, SMALL_ANGLE, STATE_AT } from "../generated/constants.ts";
import { atlasSamples, basesAfter, readCodes } from "./atlas.ts";
import { FormatError } from "./errors.ts";
import { levelRows } from "./files.ts";
import { colourChannels, colourMatrix, colourSteps, differenceSteps, gridUnit, keySteps, stateSteps } from "./steps.ts";
import type { Canonical, Gaussians, Group, KeyPart, Root } from "./types.ts";

/** What codes of a key or of a state count in. */
interface Coding {
  /** Value of a code of each channel. */
  steps: Float32Array;
  /** (C · C) what a code of each colour channel adds to each colour. */
  colours: Float64Array;
}

/** Throws FormatError(bad_value) for a broken colour transform. */
function codingOf(root: Root, group: Group, steps: Float32Array, scales: { sh_dc: number; sh_rest: number }): Coding {
  const channels = colourChannels(root.sh_degree);
  const scale = colourSteps(scales, channels).map((step) => step * steps.at(-1)!); // of all colour channels
  const colours = Float64Array.from(colourMatrix(group, channels), (entry, i) => entry * scale[i % channels]!);
  return { steps, colours };
}

/** The Gaussians of a canonical space; α is not limited yet.
 *
 * Throws FormatError(bad_value) for numbers not finite.
 */
export function canonicalGaussians(root: Root, group: Group, canonical: Canonical): Gaussians {
  const { means } = canonical;
  const rows = means.length / 3;
  const gaussians = {
    means,
    quaternions: new Float32Array(4 * rows),
    logScales: new Float32Array(3 * rows),
    alpha: new Float32Array(rows),
    colours: new Float32Array(colourChannels(root.sh_degree) * rows),
  };
  let first = 0;
  const codesOf = ({ atlas, luma, bases }: KeyPart) => readCodes(atlas, luma, basesAfter(atlasSamples(atlas), [bases]));
  const coding = (steps: Float32Array, factor: number) =>
    codingOf(
      root,
      group,
      steps.map((step) => step * factor),
      group.key_steps,
    );
  for (const part of canonical.parts) {
    const { atlas, factor, difference } = part;
    const own = coding(keySteps(root, group, canonical.quality), factor);
    setKey(gaussians, first, codesOf(part), own, Math.log(gridUnit(group)));
    if (difference) {
      const steps = differenceSteps(root, group, canonical.quality).fill(0, 0, 3); // means have it already
      const rows = Uint32Array.from({ length: atlas.rows }, (_, i) => first + i);
      addState(gaussians, rows, canonical.units, codesOf(difference), coding(steps, factor));
    }
    first += atlas.rows;
  }
  expectFinite(gaussians, "canonical space");
  return gaussians;
}

type Codes = Int32Array | Float64Array;

/** Writes n rows from `first` on: what (7 + C · n) key codes decode to. Log-scales are more than coded by `size`. */
function setKey(gaussians: Gaussians, first: number, codes: Codes, { steps, colours }: Coding, size: number): void {
  const rows = codes.length / steps.length;
  const value = (channel: number, i: number) => codes[channel * rows + i]! * steps[channel]!;
  for (let i = 0; i < rows; i++) {
    const row = first + i;
    for (let axis = 0; axis < 3; axis++)
      gaussians.logScales[3 * row + axis] = size + value(KEY_AT.log_scales + axis, i);
    gaussians.quaternions.set(rotation(value, KEY_AT.quaternions, i), 4 * row);
    gaussians.alpha[row] = value(KEY_AT.opacity, i);
  }
  addColours(gaussians.colours, (i) => first + i, codes.subarray(KEY_AT.colour * rows), { colours, rows });
}

/** The Gaussians of a frame: `base` is what `canonicalGaussians` gave, `state` the picture of the frame with the bases of
 * its samples (null: all 0) and the slopes of the segment; null: no state is added. Where `canonical` has fewer tiers
 * than the level asks for, its rows are the first of the level.
 *
 * Throws FormatError(bad_value) for numbers not finite.
 */
export function shownGaussians(
  root: Root,
  group: Group,
  base: Gaussians,
  canonical: Canonical,
  state: { level: number; luma: Uint8Array; bases: Int32Array | null; slopes: Int32Array | null; time: number } | null,
): Gaussians {
  const shown = {
    means: base.means.slice(),
    quaternions: base.quaternions.slice(),
    logScales: base.logScales.slice(),
    alpha: base.alpha.slice(),
    colours: base.colours.slice(),
  };
  if (state) {
    const rows = levelRows(canonical.depths, state.level);
    const atlas = group.levels[state.level]!;
    const codes = readCodes(atlas, state.luma, state.bases, state.slopes, state.time);
    const coding = codingOf(root, group, stateSteps(root, group, state.level), group.state_steps);
    addState(shown, rows, canonical.units, codes, coding);
  }
  expectFinite(shown, "frame");
  shown.alpha.forEach((alpha, row) => {
    shown.alpha[row] = Math.min(Math.max(alpha, OPACITY_MARGIN), 1 - OPACITY_MARGIN);
  });
  return shown;
}

/** Adds to (≤ n) rows what (10 + C · n) state codes decode to. `units` (N) are motion units. */
function addState(
  gaussians: Gaussians,
  rows: Uint32Array,
  units: Float32Array,
  codes: Codes,
  { steps, colours }: Coding,
): void {
  const count = codes.length / steps.length;
  const value = (channel: number, i: number) => codes[channel * count + i]! * steps[channel]!;
  rows.forEach((row, i) => {
    for (let axis = 0; axis < 3; axis++) {
      gaussians.means[3 * row + axis]! += value(STATE_AT.means + axis, i) * units[row]!;
      gaussians.logScales[3 * row + axis]! += value(STATE_AT.log_scales + axis, i);
    }
    const quaternion = gaussians.quaternions.subarray(4 * row, 4 * row + 4);
    quaternion.set(product(rotation(value, STATE_AT.quaternions, i), quaternion));
    gaussians.alpha[row]! += value(STATE_AT.opacity, i);
  });
  const colourCodes = codes.subarray(STATE_AT.colour * count);
  addColours(gaussians.colours, (i) => rows[i] ?? null, colourCodes, { colours, rows: count });
}

/** Adds what (C · n) colour codes decode to; `rowOf` says where the i-th of n rows stands, null: nowhere. */
function addColours(
  into: Float32Array,
  rowOf: (i: number) => number | null,
  codes: Codes,
  { colours, rows }: { colours: Float64Array; rows: number },
): void {
  const channels = codes.length / rows;
  const sums = new Float64Array(channels);
  for (let i = 0; i < rows; i++) {
    const row = rowOf(i);
    if (row === null) return;
    sums.fill(0);
    for (let k = 0; k < channels; k++) {
      const code = codes[k * rows + i]!;
      if (code) for (let c = 0; c < channels; c++) sums[c]! += code * colours[k * channels + c]!;
    }
    for (let c = 0; c < channels; c++) into[channels * row + c]! += sums[c]!;
  }
}

type Quaternion = [number, number, number, number];

/** The unit quaternion w, x, y, z of the rotation vector that stands in three channels of the i-th row. */
function rotation(value: (channel: number, i: number) => number, channel: number, i: number): Quaternion {
  const [x, y, z] = [value(channel, i), value(channel + 1, i), value(channel + 2, i)];
  const angle = Math.sqrt(x * x + y * y + z * z);
  const factor = angle > SMALL_ANGLE ? Math.sin(angle / 2) / angle : 0.5;
  return [Math.cos(angle / 2), factor * x, factor * y, factor * z];
}

/** The Hamilton product: the rotation by `b`, then by `a`. */
function product([aw, ax, ay, az]: Quaternion, b: Float32Array): Quaternion {
  const [bw, bx, by, bz] = b as unknown as Quaternion;
  return [
    aw * bw - ax * bx - ay * by - az * bz,
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
  ];
}

function expectFinite(gaussians: Gaussians, where: string): void {
  for (const [name, values] of Object.entries(gaussians) as [string, Float32Array][]) {
    let zero = 0;
    for (let i = 0; i < values.length; i++) zero += values[i]! * 0; // NaN where a value is not finite
    if (zero !== 0) throw new FormatError("bad_value", where, `${name} decode to numbers not finite`);
  }
}

// Codes to Gaussians on the CPU: FORMAT.md, section 5. It is what shaders are tested against, and what adapters to
// other renderers feed. N rows of a group, n rows of a keyframe tier or a level, C colour channels.
import { DELTA_AT, KEYFRAME_AT, OPACITY_MARGIN, SMALL_ANGLE } from "../generated/constants.ts";
import { atlasSamples, basesAfter, readCodes } from "./atlas.ts";
import { FormatError } from "./errors.ts";
import { levelRows } from "./files.ts";
import {
  colourChannels,
  colourMatrix,
  colourSteps,
  deltaSteps,
  differenceSteps,
  gridUnit,
  keyframeSteps,
} from "./steps.ts";
import type { Canonical, Gaussians, Group, KeyframePart, Root } from "./types.ts";

interface Coding {
  /** Value of a code of each channel. */
  steps: Float32Array;
  /** (C · C) what a code of each colour channel adds to each colour. */
  colours: Float64Array;
  /** The first channel of each attribute; keyframes have no means. */
  at: { means?: number; log_scales: number; quaternions: number; opacity: number; colour: number };
  /** What log-scales are more than coded. */
  size: number;
}

/** Throws FormatError(bad_value) for a broken colour transform. */
function codingOf(
  root: Root,
  group: Group,
  steps: Float32Array,
  scales: { sh_dc: number; sh_rest: number },
  at: Coding["at"] = DELTA_AT,
  size = 0,
): Coding {
  const channels = colourChannels(root.sh_degree);
  const scale = colourSteps(scales, channels).map((step) => step * steps.at(-1)!); // of all colour channels
  const colours = Float64Array.from(colourMatrix(group, channels), (entry, i) => entry * scale[i % channels]!);
  return { steps, colours, at, size };
}

/** The Gaussians of a canonical space; α is not limited yet. Throws FormatError(bad_value) for numbers not finite. */
export function canonicalGaussians(root: Root, group: Group, canonical: Canonical): Gaussians {
  const { means, units, quality } = canonical;
  const gaussians = {
    means,
    quaternions: new Float32Array(4 * units.length).map((_, i) => (i % 4 ? 0 : 1)),
    logScales: new Float32Array(3 * units.length),
    alpha: new Float32Array(units.length),
    colours: new Float32Array(colourChannels(root.sh_degree) * units.length),
  };
  let first = 0;
  const codesOf = ({ atlas, luma, bases }: KeyframePart) =>
    readCodes(atlas, luma, basesAfter(atlasSamples(atlas), [bases]));
  for (const part of canonical.parts) {
    const { atlas, factor, difference } = part;
    const rows = Uint32Array.from({ length: atlas.rows }, (_, i) => first + i);
    const steps = keyframeSteps(root, group, quality).map((step) => step * factor);
    const coding = codingOf(root, group, steps, group.keyframe_steps, KEYFRAME_AT, Math.log(gridUnit(group)));
    add(gaussians, rows, units, codesOf(part), coding);
    if (difference) {
      const steps = differenceSteps(root, group, quality).map((step, i) => (i < 3 ? 0 : step * factor)); // not means
      add(gaussians, rows, units, codesOf(difference), codingOf(root, group, steps, group.keyframe_steps));
    }
    first += atlas.rows;
  }
  expectFinite(gaussians, "canonical space");
  return gaussians;
}

/** The Gaussians of a frame: `base` is what `canonicalGaussians` gave, `delta` the picture of the frame with the bases
 * of its samples (null: all 0) and the slopes of the segment; null: no delta is added. Where `canonical` has fewer
 * tiers than the level asks for, its rows are the first of the level.
 *
 * Throws FormatError(bad_value) for numbers not finite.
 */
export function shownGaussians(
  root: Root,
  group: Group,
  base: Gaussians,
  canonical: Canonical,
  delta: { level: number; luma: Uint8Array; bases: Int32Array | null; slopes: Int32Array | null; time: number } | null,
): Gaussians {
  const shown = structuredClone(base);
  if (delta) {
    const rows = levelRows(canonical.depths, delta.level);
    const codes = readCodes(group.levels[delta.level]!, delta.luma, delta.bases, delta.slopes, delta.time);
    const coding = codingOf(root, group, deltaSteps(root, group, delta.level), group.delta_steps);
    add(shown, rows, canonical.units, codes, coding);
  }
  expectFinite(shown, "frame");
  shown.alpha.forEach((alpha, row) => {
    shown.alpha[row] = Math.min(Math.max(alpha, OPACITY_MARGIN), 1 - OPACITY_MARGIN);
  });
  return shown;
}

/** Adds to (≤ n) rows what n of each channel's codes decode to. `units` (N) are motion units. */
function add(
  gaussians: Gaussians,
  rows: Uint32Array,
  units: Float32Array,
  codes: Int32Array | Float64Array,
  { steps, colours, at, size }: Coding,
): void {
  const count = codes.length / steps.length;
  const value = (channel: number, i: number) => codes[channel * count + i]! * steps[channel]!;
  const channels = Math.sqrt(colours.length);
  const sums = new Float64Array(channels);
  rows.forEach((row, i) => {
    for (let axis = 0; axis < 3; axis++) {
      if (at.means !== undefined) gaussians.means[3 * row + axis]! += value(at.means + axis, i) * units[row]!;
      gaussians.logScales[3 * row + axis]! += size + value(at.log_scales + axis, i);
    }
    const quaternion = gaussians.quaternions.subarray(4 * row, 4 * row + 4);
    quaternion.set(product(rotation(value, at.quaternions, i), quaternion));
    gaussians.alpha[row]! += value(at.opacity, i);
    sums.fill(0);
    for (let k = 0; k < channels; k++) {
      const code = codes[(at.colour + k) * count + i]!;
      if (code) for (let c = 0; c < channels; c++) sums[c]! += code * colours[k * channels + c]!;
    }
    for (let c = 0; c < channels; c++) gaussians.colours[channels * row + c]! += sums[c]!;
  });
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

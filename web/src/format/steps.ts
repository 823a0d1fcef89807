// What codes count in: FORMAT.md, section 5. C colour channels.
import { DELTA_CHANNELS, KEYFRAME_CHANNELS, TRANSFORM_UNITS } from "../generated/constants.ts";
import { FormatError } from "./errors.ts";
import type { Group, Root } from "./types.ts";

/** C: r, g, b of SH DC and of each of the coefficients past it. */
export const colourChannels = (shDegree: number) => 3 * (shDegree + 1) ** 2;

/** (7 + C) value of a code of each keyframe channel, in a tier of factor 1. */
export function keyframeSteps(root: Root, group: Group, quality: number): Float32Array {
  const steps = KEYFRAME_CHANNELS.map((attribute) => group.keyframe_steps[attribute]);
  return scaled(steps, root, root.qualities[quality]!.factor / root.keyframe_gain);
}

export const gridUnit = ({ grid }: Group) => grid.step * 2 ** -grid.finest;

/** (10 + C) the same of keyframes that are differences; of a mean in motion units of its row. */
export function differenceSteps(root: Root, group: Group, quality: number): Float32Array {
  const steps = DELTA_CHANNELS.map((name) => (name === "means" ? gridUnit(group) : group.keyframe_steps[name]));
  return scaled(steps, root, root.qualities[quality]!.factor / root.keyframe_gain);
}

/** (10 + C) value of a code of each delta channel; of a mean in motion units of its row. */
export function deltaSteps(root: Root, group: Group, level: number): Float32Array {
  const steps = DELTA_CHANNELS.map((attribute) => group.delta_steps[attribute]);
  return scaled(steps, root, root.levels[level]!.factor / root.delta_gain);
}

function scaled(steps: number[], root: Root, scale: number): Float32Array {
  const colours = new Array<number>(colourChannels(root.sh_degree)).fill(1);
  return Float32Array.from([...steps, ...colours], (step) => step * scale);
}

/** (C) step of each colour, by which what the transform gives is multiplied. */
export function colourSteps(steps: { sh_dc: number; sh_rest: number }, channels: number): Float32Array {
  return Float32Array.from({ length: channels }, (_, i) => (i < 3 ? steps.sh_dc : steps.sh_rest));
}

/** (C · C) colour transform: row k is what colour channel k adds. Throws FormatError(bad_value). */
export function colourMatrix(group: Group, channels: number): Float32Array {
  let bytes: string | null = null;
  try {
    bytes = atob(group.colour_transform);
  } catch {}
  if (bytes?.length !== 2 * channels * channels) {
    const got = bytes === null ? "no base64" : `${bytes.length} bytes`;
    throw new FormatError("bad_value", "colour_transform", `expected ${channels} × ${channels} int16, got ${got}`);
  }
  const view = new DataView(Uint8Array.from(bytes, (letter) => letter.charCodeAt(0)).buffer);
  return Float32Array.from({ length: channels * channels }, (_, i) => view.getInt16(2 * i, true) / TRANSFORM_UNITS);
}

// What is decoded: canonical spaces (sidecars and keyframe files, those of a base too) and segments over them (delta files).
// N rows of a group, n of a level.
import { planeCorner, slopeCodes } from "../format/atlas.ts";
import { concat } from "../format/collections.ts";
import { FormatError } from "../format/errors.ts";
import { type Bases, checkCount, type KeyframeTier, levelRows, readDeltas, readKeyframeTier } from "../format/files.ts";
import type { Tables } from "../format/package.ts";
import { deltaSteps, differenceSteps } from "../format/steps.ts";
import type { Canonical, CanonicalName, DeltaFrame, KeyframePart } from "../format/types.ts";
import { ESCAPE_UNIT, GREY } from "../generated/constants.ts";
import type { DecodeOptions } from "./decoder.ts";
import type { PictureDecoder } from "./pictures.ts";

export type Positions = Pick<Canonical, "means" | "units" | "depths">;

export type ReadFile = (path: string) => Uint8Array;

/** A canonical space, luma included. Throws FormatError. */
export async function decodeCanonical(
  tables: Tables,
  read: ReadFile,
  name: CanonicalName,
  decoder: PictureDecoder,
  options: DecodeOptions,
): Promise<Canonical> {
  const decode = async ({ atlas, factor, pages, checksums, changes: bases, where }: KeyframeTier) => {
    const found: KeyframePart[] = [];
    const take = (_: number, luma: Uint8Array) => found.push({ atlas, factor, luma, bases, difference: null });
    if (pages.length) await decoder.decode({ pages, checksums, atlas, frames: 1, where }, take, options);
    return found[0] ?? null;
  };
  const base = tables.base(name.group);
  const keyframes = readTiers(tables, read, name);
  const whole = base === null ? keyframes : readTiers(tables, read, { ...name, group: base });
  const steps = differenceSteps(tables.root, tables.group(name.group), name.quality);
  const parts: KeyframePart[] = [];
  const means: Float32Array[] = [];
  for (const [i, tier] of whole.entries()) {
    const keyframe = keyframes[i];
    const part = await decode(tier);
    const difference = keyframe === tier ? null : await decode(keyframe);
    parts.push({ ...part, difference });
    const rows = Uint32Array.from(keyframe.depths, (_, row) => row);
    const scaled = steps.map((step) => step * keyframe.factor);
    const moved = difference ? movedMeans(tier, rows, keyframe.bases, scaled, difference.luma) : tier.means;
    if (!moved.every(Number.isFinite)) throw new FormatError("bad_value", keyframe.where, "means are not finite");
    means.push(moved);
  }
  const [depths, units] = [keyframes.map((keyframe) => keyframe.depths), whole.map((tier) => tier.units)];
  const space = { means: concat(Float32Array, means), units: concat(Float32Array, units) };
  return { ...name, ...space, depths: concat(Uint8Array, depths), parts };
}

function readTiers(tables: Tables, read: ReadFile, { group, quality, tiers }: CanonicalName): KeyframeTier[] {
  const found: KeyframeTier[] = [];
  for (let tier = 0; tier < tiers; tier++) {
    const [sidecar, media] = tables.keyframeFiles(group, tier, quality);
    if (!sidecar) continue;
    const place = { group, tier, quality };
    found.push(readKeyframeTier(tables.root, tables.group(group), place, read(sidecar), media ? read(media) : null));
  }
  return found;
}

const AXES = 3; // the first delta channels: means

/** A delta file and the canonical space that it changes, as far as `positions` have tiers; segments count from 0. */
export interface DeltaFile extends CanonicalName {
  segment: number;
  level: number;
  positions: Positions;
  bytes: Uint8Array;
  where: string;
}

/** Decodes a delta file frame by frame. Throws FormatError. */
export async function decodeDeltas(
  tables: Tables,
  file: DeltaFile,
  decoder: PictureDecoder,
  take: (t: number, frame: DeltaFrame) => void,
  options: DecodeOptions,
): Promise<void> {
  const { segment, group, level, positions, where } = file;
  const table = tables.group(group);
  checkCount(tables.root, table, level, file.tiers, positions.depths);
  const place = segment - tables.segmentsOf(group).start;
  const deltas = readDeltas(table, { segment, place, level }, file.bytes);
  const { bases, frames, slopes: front } = deltas;
  const carried = levelRows(positions.depths, level);
  const steps = deltaSteps(tables.root, table, level);
  let slopes: Int32Array | null = null;
  const rise = (_: number, luma: Uint8Array) => {
    slopes = slopeCodes(luma, front!.bases);
  };
  if (front) await decoder.decode({ ...deltas, ...front, frames: 1, where }, rise, options);
  const show = (t: number, luma: Uint8Array) => {
    const time = front ? (2 * t) / (frames - 1) - 1 : 0;
    const changes = bases.next(t, t ? null : slopes?.slice()); // the page gets them, others stay here
    const means = movedMeans(positions, carried, bases, steps, luma, slopes, time);
    take(t, { luma, bases: changes, time, means });
  };
  await decoder.decode({ ...deltas, where }, show, options);
}

/** (3N) means that a picture moves, whose bases are those of now, with slopes at a time; `rows` are of its atlas. */
function movedMeans(
  { means: before, units }: Pick<Positions, "means" | "units">,
  rows: Uint32Array,
  { atlas, now, offsets }: Bases,
  steps: Float32Array,
  luma: Uint8Array,
  slopes: Int32Array | null = null,
  time = 0,
): Float32Array {
  const means = before.slice();
  for (let axis = 0; axis < AXES; axis++) {
    const [centre, step, plane] = [atlas.centres[axis], steps[axis], atlas.planes.indexOf(axis)];
    if (plane < 0 && !centre) continue;
    const [corner, first] = [plane < 0 ? 0 : planeCorner(atlas, plane), plane * atlas.rows];
    for (let i = 0; i < rows.length; i++) {
      const at = corner + offsets[i];
      const more = (now.length ? ESCAPE_UNIT * now[first + i] : 0) + (slopes ? time * slopes[at] : 0);
      const code = plane < 0 ? centre : luma[at] - GREY + centre + more;
      means[AXES * rows[i] + axis] += Math.fround(code * step) * units[rows[i]];
    }
  }
  return means;
}

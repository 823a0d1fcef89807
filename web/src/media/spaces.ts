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

/** Resolves when the file is there. */
export type ReadFile = (path: string) => Promise<Uint8Array>;

export type TierName = Record<"group" | "tier" | "quality", number>;
/** A keyframe tier with its samples; null: it has no picture. */
export type Tier = KeyframeTier & { luma: Uint8Array | null };

/** A keyframe tier; null: it has no rows. Throws FormatError. */
export async function decodeTier(
  tables: Tables,
  { group, tier, quality }: TierName,
  read: ReadFile,
  decoder: PictureDecoder,
): Promise<Tier | null> {
  const [sidecar, media] = tables.keyframeFiles(group, tier, quality);
  if (!sidecar) return null;
  const files = await Promise.all([read(sidecar), media ? read(media) : null]);
  const found = readKeyframeTier(tables.root, tables.group(group), { group, tier, quality }, ...files);
  const decoded: Tier = { ...found, luma: null };
  const take = (_: number, luma: Uint8Array) => void Object.assign(decoded, { luma });
  if (found.pages.length) await decoder.decode({ ...found, frames: 1 }, take);
  return decoded;
}

/** A canonical space, luma included, of tiers that stay as they are. Throws FormatError. */
export async function decodeCanonical(
  tables: Tables,
  name: CanonicalName,
  decode: (name: TierName) => Promise<Tier | null>,
): Promise<Canonical> {
  const groups = [name.group, tables.base(name.group) ?? []].flat();
  const both = (tier: number) => Promise.all(groups.map((group) => decode({ ...name, group, tier })));
  const coming = await Promise.all(Array.from({ length: name.tiers }, (_, tier) => both(tier)));
  const tiers = coming.filter(([keyframe]) => keyframe) as Tier[][];
  const steps = differenceSteps(tables.root, tables.group(name.group), name.quality);
  const parts: KeyframePart[] = [];
  const means: Float32Array[] = [];
  for (const [keyframe, tier = keyframe] of tiers) {
    const difference = keyframe === tier ? null : partOf(keyframe);
    parts.push({ ...partOf(tier)!, difference });
    const rows = Uint32Array.from(keyframe.depths, (_, row) => row);
    const scaled = steps.map((step) => step * keyframe.factor);
    const moved = difference ? movedMeans(tier, rows, keyframe.bases, scaled, difference.luma) : tier.means;
    if (!moved.every(Number.isFinite)) throw new FormatError("bad_value", keyframe.where, "means are not finite");
    means.push(moved);
  }
  const [depths, units] = [tiers.map(([{ depths }]) => depths), tiers.map((of) => of.at(-1)!.units)];
  const space = { means: concat(Float32Array, means), units: concat(Float32Array, units) };
  return { ...name, ...space, depths: concat(Uint8Array, depths), parts };
}

/** What is given away of a tier. */
function partOf({ atlas, factor, luma, changes }: Tier): KeyframePart | null {
  return luma && { atlas, factor, luma: luma.slice(), bases: structuredClone(changes), difference: null };
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
  if (front) await decoder.decode({ ...deltas, ...front, frames: 1, where }, rise, { ...options, first: 0 });
  const show = (t: number, luma: Uint8Array) => {
    const time = front ? (2 * t) / (frames - 1) - 1 : 0;
    const changes = bases.next(t, t ? null : slopes?.slice()); // the page gets them, others stay here
    const means = luma.length ? movedMeans(positions, carried, bases, steps, luma, slopes, time) : new Float32Array();
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

// The files of keyframe tiers and segments, read up to their pictures: FORMAT.md, sections 2, 3 and 6. T frames, P planes,
// N rows, E escapes: jumps of bases, by which values leave 8 bits.
import { STATIC } from "../generated/constants.ts";
import { pages, planeCorner, rowOffsets } from "./atlas.ts";
import { pageSamples } from "./avc.ts";
import { FormatError } from "./errors.ts";
import { type Media, readMedia, type Sample } from "./mp4.ts";
import { deltaMediaPath, keyframeMediaPath, keyframeSidecarPath } from "./paths.ts";
import { ColumnReader } from "./rangecoder.ts";
import { canonicalMeans, type Escapes, motionUnits, readDetail, readEscapes, readSidecar } from "./sidecar.ts";
import type { Atlas, BaseChanges, Group, Root } from "./types.ts";

/** A keyframe tier but for its picture. N rows; where keyframes are differences, M = 0 have a place, else M = N. */
export interface KeyframeTier {
  atlas: Atlas;
  /** On the keyframe steps, beside that of the keyframe quality. */
  factor: number;
  /** (3M) canonical means, world units. */
  means: Float32Array;
  /** (M) motion units, world units. */
  units: Float32Array;
  depths: Uint8Array;
  /** The file of its picture; each page of it, none where there is none. */
  where: string;
  pages: Sample[][];
  checksums: Uint32Array;
  /** Bases of its samples, and which are other than 0; null: none. */
  bases: Bases;
  changes: BaseChanges | null;
}

/** A keyframe tier from its files; `media` null: it has no picture. Throws FormatError (bad_sidecar, bad_picture). */
export function readKeyframeTier(
  root: Root,
  table: Group,
  { group, tier, quality }: { group: number; tier: number; quality: number },
  sidecar: Uint8Array,
  media: Uint8Array | null,
): KeyframeTier {
  const where = keyframeMediaPath(tier, quality, group + 1);
  const { count, factor, qualities } = table.tiers[tier]!;
  const atlas = qualities[quality]!;
  const coarsest = root.qualities.at(-1)!.coarser;
  const coarser = table.base ? coarsest : root.qualities[quality]!.coarser; // a difference has no detail of positions
  const placed = table.base ? 0 : count;
  const shared = readSidecar(sidecar, count, placed, table.grid, coarsest, keyframeSidecarPath(tier, group + 1));
  const none: Media = { checksums: new Uint32Array(), columns: null, samples: [] };
  const { checksums, columns, samples } = media ? readMedia(media, where) : none;
  const reader = new ColumnReader(columns, where);
  const rows = readDetail(reader, shared, table.grid, coarser, coarsest);
  const escapes = readEscapes(reader, 1, atlas.planes.length, atlas.rows);
  reader.close();
  const bases = new Bases(escapes, atlas);
  return {
    atlas,
    factor,
    means: new Float32Array(canonicalMeans(rows, table.grid, coarser)),
    units: motionUnits(rows.classes),
    depths: rows.depths,
    where,
    pages: media ? pageSamples(samples, atlas, 1, where) : [],
    checksums,
    bases,
    changes: bases.next(0),
  };
}

/** Segment `place` of a table but for its pictures; `segment` is its number, from 0. `slopes` is the picture of slopes,
 * null without one; its `bases` are those other than 0. Throws FormatError (bad_sidecar, bad_picture).
 */
export function readDeltas(
  table: Group,
  { segment, place, level }: { segment: number; place: number; level: number },
  media: Uint8Array,
) {
  const where = deltaMediaPath(level, segment + 1);
  const atlas = table.levels[level]!;
  const { start, stop, levels } = table.segments[place]!;
  const { checksums, columns, samples } = readMedia(media, where);
  const reader = new ColumnReader(columns, where);
  const frames = stop - start;
  const basesOf = (count: number) => new Bases(readEscapes(reader, count, atlas.planes.length, atlas.rows), atlas);
  const rising = levels[level]!.slopes ? basesOf(1) : null;
  const bases = basesOf(frames);
  reader.close();
  const front = rising ? pages(atlas) : 0;
  const pagesOf = (part: Sample[], count: number) => pageSamples(part, atlas, count, where);
  const slopes = rising && { pages: pagesOf(samples.slice(0, front), 1), checksums, bases: rising.next(0) };
  const own = pagesOf(samples.slice(front), frames);
  return { atlas, frames, pages: own, checksums: checksums.subarray(front), bases, slopes };
}

/** Rows that a level carries, ascending. `depths` (N) are those of all its rows, or of the first tiers. */
export function levelRows(depths: Uint8Array, level: number): Uint32Array {
  const rows = new Uint32Array(depths.length);
  let count = 0;
  for (let i = 0; i < depths.length; i++) {
    if (depths[i]! >= level && depths[i]! !== STATIC) rows[count++] = i;
  }
  return rows.slice(0, count);
}

/** Throws FormatError(count_mismatch) unless the sidecars of the first `tiers` give the rows that a level's atlas has;
 * with fewer tiers than the level asks for, no more than those.
 */
export function checkCount(root: Root, table: Group, level: number, tiers: number, depths: Uint8Array): void {
  const count = levelRows(depths, level).length;
  const expected = table.levels[level]!.rows;
  if (count > expected || (tiers >= root.levels[level]!.tiers && count !== expected)) {
    const detail = `the sidecars give ${count} rows, the table ${expected}`;
    throw new FormatError("count_mismatch", `levels[${level}]`, detail);
  }
}

/** The bases of an atlas from picture to picture; every picture of a file is to be asked for, in order. */
export class Bases {
  /** Bases by now, by plane · N + row; empty: all are 0. */
  readonly now: Int32Array;
  readonly offsets: Uint32Array;
  #at = 0;

  constructor(
    readonly escapes: Escapes,
    readonly atlas: Atlas,
  ) {
    this.now = new Int32Array(escapes.index.length ? atlas.planes.length * atlas.rows : 0);
    this.offsets = rowOffsets(atlas);
  }

  next(t: number, slopes?: Int32Array | null): BaseChanges | null {
    const { index, jumps } = this.escapes;
    const { rows, planes } = this.atlas;
    const area = planes.length * rows;
    const first = this.#at;
    while (this.#at < index.length && index[this.#at]! < (t + 1) * area) this.#at++;
    if (this.#at === first && !slopes) return null;
    const texels = new Uint32Array(this.#at - first);
    const bases = new Int32Array(this.#at - first);
    for (let e = first; e < this.#at; e++) {
      const sample = index[e]! % area;
      texels[e - first] = planeCorner(this.atlas, Math.floor(sample / rows)) + this.offsets[sample % rows]!;
      bases[e - first] = this.now[sample]! += jumps[e]!;
    }
    return { texels, bases, slopes };
  }
}

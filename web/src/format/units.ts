// The files of key units and segments, read up to their pictures: FORMAT.md, sections 2, 3 and 6.
import { STATIC } from "../generated/constants.ts";
import { pageSamples } from "./avc.ts";
import { FormatError } from "./errors.ts";
import { Bases, readEscapes } from "./escapes.ts";
import { readMedia, type Sample } from "./mp4.ts";
import { keyMediaPath, keySidecarPath, stateMediaPath, tileFolder } from "./paths.ts";
import { ColumnReader } from "./rangecoder.ts";
import { canonicalMeans, motionUnits, readDetail, readSidecar } from "./sidecar.ts";
import type { Atlas, BaseChanges, Group, Root } from "./types.ts";

/** A key unit but for its picture. K rows of the tier are kept, M are its own. */
export interface KeyUnit {
  atlas: Atlas;
  /** (K) rows of the same unit of the base. */
  kept: Uint32Array;
  /** (3M) canonical means, world units. */
  means: Float32Array;
  /** (M) motion units, world units. */
  units: Float32Array;
  /** (K + M) */
  depths: Uint8Array;
  /** Of each page of the picture; none where all rows are kept. */
  pages: Sample[][];
  /** Samples with another base than 0; null: none. */
  bases: BaseChanges | null;
}

/** Which key unit: group and tile count from 0. */
export interface KeyPlace {
  group: number;
  tile: number;
  tier: number;
  quality: number;
}

/** A key unit of the table of its group, from the bytes of its sidecar and of its picture, null where it has none.
 * `base` is the table of the group whose rows it keeps, if it keeps any.
 *
 * Throws FormatError (bad_sidecar, bad_picture, bad_value).
 */
export function readKeyUnit(
  root: Root,
  table: Group,
  base: Group | null,
  { group, tile, tier, quality }: KeyPlace,
  sidecar: Uint8Array,
  media: Uint8Array | null,
): KeyUnit {
  const folder = tileFolder(tile, root.tiles);
  const where = keyMediaPath(folder, tier, quality, group + 1);
  const { count, kept, qualities } = table.tiles[tile]!.tiers[tier]!;
  const atlas = qualities[quality]!;
  const coarser = root.qualities[quality]!.coarser;
  const coarsest = root.qualities.at(-1)!.coarser;
  const counts = { count, kept, base: base?.tiles[tile]?.tiers[tier]?.count ?? 0 };
  const shared = readSidecar(sidecar, counts, table.grid, coarsest, keySidecarPath(folder, tier, group + 1));
  const { columns, samples } = media ? readMedia(media, where) : { columns: null, samples: [] };
  const reader = new ColumnReader(columns, where);
  const rows = readDetail(reader, shared, table.grid, coarser, coarsest);
  const escapes = readEscapes(reader, 1, atlas.planes.length, atlas.rows);
  reader.close();
  const means = new Float32Array(canonicalMeans(rows, table.grid, coarser));
  if (!means.every(Number.isFinite)) throw new FormatError("bad_value", where, "means decode to numbers not finite");
  return {
    atlas,
    kept: shared.kept,
    means,
    units: motionUnits(rows.classes),
    depths: rows.depths,
    pages: media ? pageSamples(samples, atlas, 1, where) : [],
    bases: new Bases(escapes, atlas).next(0),
  };
}

/** A segment of a tile in a level but for its pictures. */
export interface StateUnit {
  atlas: Atlas;
  frames: number;
  /** Of each page of the pictures, in decoding order. */
  pages: Sample[][];
  bases: Bases;
}

/** Segment `place` of the table of a group in a level, from the bytes of its file of a tile; `segment` is its number in
 * the package, from 0. Throws FormatError (bad_sidecar, bad_picture).
 */
export function readStateUnit(
  table: Group,
  { segment, place, tile, level }: { segment: number; place: number; tile: number; level: number },
  media: Uint8Array,
): StateUnit {
  const where = stateMediaPath(tileFolder(tile, table.tiles.length), level, segment + 1);
  const atlas = table.tiles[tile]!.levels[level]!;
  const { start, stop } = table.segments[place]!;
  const { columns, samples } = readMedia(media, where);
  const reader = new ColumnReader(columns, where);
  const escapes = readEscapes(reader, stop - start, atlas.planes.length, atlas.rows);
  reader.close();
  const pages = pageSamples(samples, atlas, stop - start, where);
  return { atlas, frames: stop - start, pages, bases: new Bases(escapes, atlas) };
}

/** Rows of a tile that a level carries, ascending. `depths` (N) are those of all its rows, or of the first tiers. */
export function levelRows(depths: Uint8Array, level: number): Uint32Array {
  const rows = new Uint32Array(depths.length);
  let count = 0;
  for (let i = 0; i < depths.length; i++) {
    if (depths[i]! >= level && depths[i]! !== STATIC) rows[count++] = i;
  }
  return rows.slice(0, count);
}

/** Throws FormatError(count_mismatch) unless the sidecars of the first tiers of a tile, `of`, give the rows that a
 * level's atlas has; with fewer tiers than the level asks for, no more than those.
 */
export function checkCount(
  root: Root,
  table: Group,
  level: number,
  of: { tile: number; tiers: number },
  depths: Uint8Array,
): void {
  const count = levelRows(depths, level).length;
  const expected = table.tiles[of.tile]!.levels[level]!.rows;
  const complete = of.tiers >= root.levels[level]!.tiers;
  if (count > expected || (complete && count !== expected)) {
    const detail = `the sidecars give ${count} rows, the table ${expected}`;
    throw new FormatError("count_mismatch", `tiles[${of.tile}].levels[${level}]`, detail);
  }
}

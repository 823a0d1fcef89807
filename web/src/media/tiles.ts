// What is decoded of tiles: canonical spaces (sidecars and key files, those of a base too) and segments over them (state
// files). N rows of a tile, n of a level.
import { planeCorner, rowOffsets } from "../format/atlas.ts";
import type { Tables } from "../format/package.ts";
import { stateSteps } from "../format/steps.ts";
import type { Canonical, CanonicalName, KeyPart, StateFrame } from "../format/types.ts";
import {
  type Bases,
  checkCount,
  type KeyPlace,
  type KeyUnit,
  levelRows,
  readKeyUnit,
  readStateUnit,
} from "../format/units.ts";
import { ESCAPE_UNIT, GREY } from "../generated/constants.ts";
import type { DecodeOptions } from "./decoder.ts";
import type { PictureDecoder } from "./pictures.ts";

export type Positions = Pick<Canonical, "means" | "units" | "depths">;

/** Gives the bytes of a file. Throws FormatError(missing_file). */
export type ReadFile = (path: string) => Uint8Array;

/** Rows of a unit that follow each other in a space. */
interface Run {
  unit: KeyUnit;
  kept: Uint32Array | null;
}

/** The positions of the rows of a canonical space. Throws FormatError. */
export function readPositions(tables: Tables, read: ReadFile, name: CanonicalName): Positions {
  return joinPositions(readTiers(tables, read, name));
}

/** A canonical space, luma included. Throws FormatError. */
export async function decodeCanonical(
  tables: Tables,
  read: ReadFile,
  name: CanonicalName,
  decoder: PictureDecoder,
  options: DecodeOptions,
): Promise<Canonical> {
  const tiers = readTiers(tables, read, name);
  const parts: KeyPart[] = [];
  for (const { unit, kept } of tiers.flatMap(runsOf)) {
    const { atlas, factor, pages, checksums, bases, where } = unit;
    const take = (_: number, luma: Uint8Array) => parts.push({ atlas, factor, kept, luma, bases });
    await decoder.decode({ pages, checksums, atlas, frames: 1, where }, take, options);
  }
  return { ...name, ...joinPositions(tiers), parts };
}

/** A tier, and that of the base whose rows it keeps. */
interface Tier {
  own: KeyUnit;
  base: KeyUnit | null;
}

/** Kept rows, then others, as far as there are any. */
function runsOf({ own, base }: Tier): Run[] {
  const runs: Run[] = base ? [{ unit: base, kept: own.kept }] : [];
  return own.pages.length ? [...runs, { unit: own, kept: null }] : runs;
}

function readTiers(tables: Tables, read: ReadFile, { group, tile, quality, tiers }: CanonicalName): Tier[] {
  const base = tables.base(group);
  const found: Tier[] = [];
  for (let tier = 0; tier < Math.min(tiers, tables.root.tiers); tier++) {
    const own = readUnit(tables, read, { group, tile, tier, quality });
    const keeps = base !== null && own?.kept.length;
    if (own) found.push({ own, base: keeps ? readUnit(tables, read, { group: base, tile, tier, quality }) : null });
  }
  return found;
}

function readUnit(tables: Tables, read: ReadFile, place: KeyPlace): KeyUnit | null {
  const { group, tile, tier, quality } = place;
  const [sidecar, media] = tables.keyFiles(group, tile * tables.root.tiers + tier, quality);
  if (!sidecar) return null;
  const [table, base] = [tables.group(group), tables.baseTable(group)];
  return readKeyUnit(tables.root, table, base, place, read(sidecar), media ? read(media) : null);
}

function joinPositions(tiers: Tier[]): Positions {
  const rows = tiers.reduce((sum, { own }) => sum + own.depths.length, 0);
  const all = { means: new Float32Array(3 * rows), units: new Float32Array(rows), depths: new Uint8Array(rows) };
  let at = 0;
  for (const { own, base } of tiers) {
    all.depths.set(own.depths, at);
    for (const row of own.kept) {
      for (let axis = 0; axis < 3; axis++) all.means[3 * at + axis] = base!.means[3 * row + axis];
      all.units[at++] = base!.units[row];
    }
    all.means.set(own.means, 3 * at);
    all.units.set(own.units, at);
    at += own.units.length;
  }
  return all;
}

const AXES = 3; // the first state channels: means

/** A state file and the canonical space that it changes. */
export interface StateFile {
  /** Segment and group, counted from 0. */
  segment: number;
  group: number;
  level: number;
  tile: number;
  /** How many key tiers of the tile `positions` has. */
  tiers: number;
  positions: Positions;
  bytes: Uint8Array;
  where: string;
}

/** Decodes a state file frame by frame. Throws FormatError. */
export async function decodeStates(
  tables: Tables,
  file: StateFile,
  decoder: PictureDecoder,
  take: (t: number, frame: StateFrame) => void,
  options: DecodeOptions,
): Promise<void> {
  const { segment, group, tile, level, where } = file;
  const table = tables.group(group);
  checkCount(tables.root, table, level, file, file.positions.depths);
  const place = segment - tables.segmentsOf(group).start;
  const { atlas, frames, pages, checksums, bases } = readStateUnit(table, { segment, place, tile, level }, file.bytes);
  const means = new Means(file, bases, stateSteps(tables.root, table, level));
  const show = (t: number, luma: Uint8Array) => take(t, { luma, bases: bases.next(t), means: means.of(luma) });
  await decoder.decode({ pages, checksums, atlas, frames, where }, show, options);
}

/** Means from frame to frame: what the depth order is made of. */
class Means {
  readonly #positions: Positions;
  readonly #rows: Uint32Array;
  readonly #offsets: Uint32Array;

  constructor(
    { positions, level }: StateFile,
    readonly bases: Bases,
    readonly steps: Float32Array,
  ) {
    this.#positions = positions;
    this.#rows = levelRows(positions.depths, level);
    this.#offsets = rowOffsets(bases.atlas);
  }

  /** (3N) means of the picture whose bases are those of now. */
  of(luma: Uint8Array): Float32Array {
    const means = this.#positions.means.slice();
    for (let axis = 0; axis < AXES; axis++) this.#move(means, axis, luma);
    const { rows, planes } = this.bases.atlas;
    for (const [sample, base] of this.bases.now) {
      const [axis, i] = [planes[Math.floor(sample / rows)], sample % rows];
      if (axis < AXES && i < this.#rows.length) this.#add(means, i, axis, ESCAPE_UNIT * base);
    }
    return means;
  }

  #move(means: Float32Array, axis: number, luma: Uint8Array): void {
    const { atlas } = this.bases;
    const centre = atlas.centres[axis];
    const plane = atlas.planes.indexOf(axis);
    if (plane < 0 && !centre) return;
    const corner = plane < 0 ? 0 : planeCorner(atlas, plane);
    const [rows, offsets, { units }, step] = [this.#rows, this.#offsets, this.#positions, this.steps[axis]];
    for (let i = 0; i < rows.length; i++) {
      const [code, row] = [plane < 0 ? centre : luma[corner + offsets[i]] - GREY + centre, rows[i]];
      means[AXES * row + axis] += Math.fround(code * step) * units[row];
    }
  }

  /** Adds a code to the mean of the i-th row of the level. */
  #add(means: Float32Array, i: number, axis: number, code: number): void {
    const row = this.#rows[i];
    means[AXES * row + axis] += Math.fround(code * this.steps[axis]) * this.#positions.units[row];
  }
}

// Canonical spaces of tiles: sidecars and key files, those of a base too -> positions, luma and bases. N rows.
import type { Tables } from "../format/package.ts";
import type { Canonical, KeyPart } from "../format/types.ts";
import { type KeyPlace, type KeyUnit, readKeyUnit } from "../format/units.ts";
import type { DecodeOptions } from "./decoder.ts";
import type { CanonicalName } from "./messages.ts";
import type { PictureDecoder } from "./pictures.ts";

/** Where rows are, and how they move. */
export type Positions = Pick<Canonical, "means" | "units" | "depths">;

/** Gives the bytes of a file. Throws FormatError(missing_file). */
export type ReadFile = (path: string) => Uint8Array;

interface Unit extends KeyUnit {
  /** The file of its picture. */
  where: string;
}

/** Rows of a unit that follow each other in a space. */
interface Run {
  unit: Unit;
  /** Which of them; null: all. */
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
    const { atlas, pages, bases, where } = unit;
    const take = (_: number, luma: Uint8Array) => parts.push({ atlas, kept, luma, bases });
    await decoder.decode({ pages, atlas, frames: 1, where }, take, options);
  }
  return { ...name, ...joinPositions(tiers), parts };
}

/** A tier, and that of the base whose rows it keeps. */
interface Tier {
  own: Unit;
  base: Unit | null;
}

/** Kept rows, then others, as far as there are any. */
function runsOf({ own, base }: Tier): Run[] {
  const runs: Run[] = base ? [{ unit: base, kept: own.kept }] : [];
  return own.where ? [...runs, { unit: own, kept: null }] : runs;
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

function readUnit(tables: Tables, read: ReadFile, place: KeyPlace): Unit | null {
  const { group, tile, tier, quality } = place;
  const [sidecar, where = ""] = tables.keyFiles(group, tile * tables.root.tiers + tier, quality);
  if (!sidecar) return null;
  const [table, base] = [tables.group(group), tables.baseTable(group)];
  return { ...readKeyUnit(tables.root, table, base, place, read(sidecar), where ? read(where) : null), where };
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

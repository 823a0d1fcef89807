// Canonical spaces: sidecars and key files -> positions, luma and bases. N rows.
import { FormatError } from "../format/errors.ts";
import type { Tables } from "../format/package.ts";
import type { Canonical, KeyPart } from "../format/types.ts";
import { type KeyUnit, readKeyUnit } from "../format/units.ts";
import type { DecodeOptions } from "./decoder.ts";
import type { CanonicalName } from "./messages.ts";
import type { PictureDecoder } from "./pictures.ts";

/** Where rows are, and how they move. */
export type Positions = Pick<Canonical, "means" | "units" | "depths">;

/** Gives the bytes of a file. Throws FormatError(missing_file). */
export type ReadFile = (path: string) => Uint8Array;

interface Unit extends KeyUnit {
  where: string;
}

/** The positions of the rows of a canonical space. Throws FormatError. */
export function readPositions(tables: Tables, read: ReadFile, name: CanonicalName): Positions {
  return joinPositions(readUnits(tables, read, name));
}

/** A canonical space, luma included. Throws FormatError. */
export async function decodeCanonical(
  tables: Tables,
  read: ReadFile,
  name: CanonicalName,
  decoder: PictureDecoder,
  options: DecodeOptions,
): Promise<Canonical> {
  const units = readUnits(tables, read, name);
  const parts: KeyPart[] = [];
  for (const { atlas, pages, bases, where } of units) {
    const take = (_: number, luma: Uint8Array) => parts.push({ atlas, luma, bases });
    await decoder.decode({ pages, atlas, frames: 1, where }, take, options);
  }
  return { ...name, ...joinPositions(units), parts };
}

function readUnits(tables: Tables, read: ReadFile, { group, quality, tiers }: CanonicalName): Unit[] {
  const table = tables.group(group);
  const units: Unit[] = [];
  for (let tier = 0; tier < Math.min(tiers, table.tiers.length); tier++) {
    const [sidecar, where] = tables.keyFiles(group, tier, quality);
    if (!where) continue;
    units.push({ ...readKeyUnit(tables.root, table, { group, tier, quality }, read(sidecar), read(where)), where });
  }
  if (!units.length) throw new FormatError("missing_entry", `group ${group}`, `${tiers} key tiers have no rows`);
  return units;
}

function joinPositions(units: Unit[]): Positions {
  const rows = units.reduce((sum, { depths }) => sum + depths.length, 0);
  const all = { means: new Float32Array(3 * rows), units: new Float32Array(rows), depths: new Uint8Array(rows) };
  let at = 0;
  for (const { means, units: motion, depths } of units) {
    all.means.set(means, 3 * at);
    all.units.set(motion, at);
    all.depths.set(depths, at);
    at += depths.length;
  }
  return all;
}

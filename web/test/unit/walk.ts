// Reads a whole package as a player does, but for its pictures.
import { existsSync } from "node:fs";
import { FormatError } from "../../src/format/errors.ts";
import { Tables } from "../../src/format/package.ts";
import { groupPath, ROOT_PATH } from "../../src/format/paths.ts";
import { checkCount, readKeyUnit, readStateUnit } from "../../src/format/units.ts";
import { pathOf, readBytes } from "./files.ts";

function read(folder: string, path: string): Uint8Array {
  if (!existsSync(pathOf(`${folder}/${path}`))) throw new FormatError("missing_file", path, "expected a file");
  return readBytes(`${folder}/${path}`);
}

async function fetched(tables: Tables, folder: string, path: string): Promise<Uint8Array> {
  const bytes = read(folder, path);
  await Tables.check(path, tables.entry(path), bytes);
  return bytes;
}

/** The tables of a package, all of them read. */
export async function readTables(folder: string): Promise<Tables> {
  const tables = Tables.parse(read(folder, ROOT_PATH));
  for (const path of tables.index.pages()) await tables.add(path, read(folder, path));
  for (let group = 0; group < tables.index.groups; group++) {
    await tables.add(groupPath(group + 1), read(folder, groupPath(group + 1)));
  }
  return tables;
}

/** Reads the key units of a tile of a group in a quality, and what they say of every level. Returns how many files. */
async function walkKeys(tables: Tables, folder: string, place: { group: number; tile: number; quality: number }) {
  const { root } = tables;
  const { group, tile, quality } = place;
  const [table, base] = [tables.group(group), tables.baseTable(group)];
  const depths: number[] = [];
  let files = 0;
  for (let tier = 0; tier < root.tiers; tier++) {
    const paths = tables.keyFiles(group, tile * root.tiers + tier, quality);
    if (!paths.length) continue;
    const [sidecar, media = null] = await Promise.all(paths.map((path) => fetched(tables, folder, path)));
    depths.push(...readKeyUnit(root, table, base, { ...place, tier }, sidecar!, media).depths);
    files += paths.length;
  }
  root.levels.forEach((_, level) => {
    checkCount(root, table, level, { tile, tiers: root.tiers }, Uint8Array.from(depths));
  });
  return files;
}

/** Reads the states of a tile of a group. Returns how many files. */
async function walkStates(tables: Tables, folder: string, group: number, tile: number): Promise<number> {
  const { start, stop } = tables.segmentsOf(group);
  let files = 0;
  for (let segment = start; segment < stop; segment++) {
    for (let level = 0; level < tables.root.levels.length; level++) {
      for (const path of tables.stateFiles(segment, level, [tile])) {
        const place = { segment, place: segment - start, tile, level };
        const unit = readStateUnit(tables.group(group), place, await fetched(tables, folder, path));
        for (let t = 0; t < unit.frames; t++) unit.bases.next(t);
        files++;
      }
    }
  }
  return files;
}

/** Reads every file that tables lead to. Returns how many there are. */
export async function walk(folder: string): Promise<number> {
  const tables = await readTables(folder);
  const { root, index } = tables;
  await fetched(tables, folder, "init.mp4");
  let files = 1;
  for (let group = 0; group < index.groups; group++) {
    for (const tile of tables.tiles) {
      for (let quality = 0; quality < root.qualities.length; quality++) {
        files += await walkKeys(tables, folder, { group, tile, quality });
      }
      files += await walkStates(tables, folder, group, tile);
    }
  }
  return files;
}

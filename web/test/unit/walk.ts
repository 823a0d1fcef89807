// Reads a whole package as a player does, but for its pictures.
import { FormatError } from "../../src/format/errors.ts";
import { checkCount, readDeltas, readKeyframeTier } from "../../src/format/files.ts";
import { Tables } from "../../src/format/package.ts";
import { groupPath } from "../../src/format/paths.ts";
import { packetsOf, readSound } from "../../src/format/sound.ts";
import { ROOT_PATH } from "../../src/generated/constants.ts";
import { type Files, readFiles } from "./files.ts";

function read(files: Files, path: string): Uint8Array {
  const bytes = files.get(path);
  if (!bytes) throw new FormatError("missing_file", path, "expected a file");
  return bytes;
}

async function fetched(tables: Tables, files: Files, path: string): Promise<Uint8Array> {
  const bytes = read(files, path);
  await Tables.check(path, tables.entry(path), bytes);
  return bytes;
}

/** The tables of a package, all of them read. */
export const readTables = (folder: string): Promise<Tables> => tablesOf(readFiles(folder));

async function tablesOf(files: Files): Promise<Tables> {
  const tables = Tables.parse(read(files, ROOT_PATH));
  for (let group = 0; group < tables.index.groups; group++) {
    for (const path of tables.index.pagesTo("groups", group)) {
      if (!tables.index.hasPage(path)) await tables.add(path, read(files, path));
    }
    await tables.add(groupPath(group + 1), read(files, groupPath(group + 1)));
  }
  return tables;
}

/** Reads the keyframe tiers of a group in a quality, and what they say of every level. Returns how many files. */
async function walkKeyframes(tables: Tables, files: Files, group: number, quality: number) {
  const { root } = tables;
  const table = tables.group(group);
  const depths: number[] = [];
  let count = 0;
  for (let tier = 0; tier < root.tiers; tier++) {
    const paths = tables.keyframeFiles(group, tier, quality);
    if (!paths.length) continue;
    const [sidecar, media = null] = await Promise.all(paths.map((path) => fetched(tables, files, path)));
    depths.push(...readKeyframeTier(root, table, { group, tier, quality }, sidecar!, media).depths);
    count += paths.length;
  }
  root.levels.forEach((_, level) => {
    checkCount(root, table, level, root.tiers, Uint8Array.from(depths));
  });
  return count;
}

/** Reads the states of a group. Returns how many files. */
async function walkDeltas(tables: Tables, files: Files, group: number): Promise<number> {
  const { start, stop } = tables.segmentsOf(group);
  let count = 0;
  for (let segment = start; segment < stop; segment++) {
    for (let level = 0; level < tables.root.levels.length; level++) {
      for (const path of tables.deltaFiles(segment, level)) {
        const place = { segment, place: segment - start, level };
        const states = readDeltas(tables.group(group), place, await fetched(tables, files, path));
        for (let t = 0; t < states.frames; t++) states.bases.next(t);
        count++;
      }
    }
  }
  return count;
}

/** Reads every file that tables lead to. Returns how many there are. */
export async function walk(files: Files): Promise<number> {
  const tables = await tablesOf(files);
  const { root, index } = tables;
  const inits = root.sound ? ["init.mp4", "sound/init.m4a"] : ["init.mp4"];
  await Promise.all(inits.map((path) => fetched(tables, files, path)));
  let count = inits.length;
  for (let group = 0; group < index.groups; group++) {
    for (const path of tables.soundFiles(group)) {
      readSound(await fetched(tables, files, path), path, packetsOf(root, tables.group(group)));
      count++;
    }
    for (let quality = 0; quality < root.qualities.length; quality++) {
      count += await walkKeyframes(tables, files, group, quality);
    }
    count += await walkDeltas(tables, files, group);
  }
  return count;
}

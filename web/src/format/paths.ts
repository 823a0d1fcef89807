// The files of a package by their paths: FORMAT.md, section 2. Numbers in paths count from 1.
import { PATHS } from "../generated/constants.ts";

/** What a path names, and the numbers in it, as they stand there. */
export interface Location {
  what: (typeof PATHS)[number][1];
  /** sidecar: tile, tier, number; key: tile, tier, quality, number; state: tile, level, number; page: level, number;
   * sound, group: number. The tile is 0 in a package that has one.
   */
  numbers: number[];
}

const PATTERNS = PATHS.map(([pattern, what]) => [new RegExp(pattern), what] as const);

/** Reads a path; null for one that is none of these. */
export function locate(path: string): Location | null {
  for (const [pattern, what] of PATTERNS) {
    const match = pattern.exec(path);
    if (match) return { what, numbers: match.slice(1).map((number = "0") => Number(number)) };
  }
  return null;
}

export const soundPath = (number: number) => `sound/${number}.m4a`;
export const pagePath = (level: number, number: number) => `index/${level}/${number}.json`;
export const groupPath = (number: number) => `group/${number}.json.gz`;
/** The part of paths that a tile, counted from 0, has in a package of so many; the only one has none. */
export const tileFolder = (tile: number, tiles: number) => (tiles > 1 ? `P${tile + 1}/` : "");
/** Sidecar of a key unit, the same for all its qualities; `folder` is that of its tile. */
export const keySidecarPath = (folder: string, tier: number, number: number) => `key/${folder}T${tier}/${number}.bin`;
export const keyMediaPath = (folder: string, tier: number, quality: number, number: number) =>
  `key/${folder}T${tier}/Q${quality}/${number}.m4s`;
export const stateMediaPath = (folder: string, level: number, number: number) =>
  `state/${folder}L${level}/${number}.m4s`;

export const isSound = (path: string): boolean => locate(path)?.what === "sound";
/** Whether a file is a page of the index or the table of a group. */
export const isTable = (path: string): boolean => ["group", "page"].includes(locate(path)?.what ?? "");

// The files of a package by their paths: FORMAT.md, section 2. Numbers in paths count from 1.

export const ROOT_PATH = "airgs.json";

/** What a path names, and the numbers in it, as they stand there. */
export interface Location {
  what: "sidecar" | "key" | "state" | "group" | "page";
  /** sidecar: tier, number; key: tier, quality, number; state, page: level, number; group: number. */
  numbers: number[];
}

const ORDINAL = "(0|[1-9][0-9]?)";
const NUMBER = "([1-9][0-9]{0,6})";
const PATTERNS: [RegExp, Location["what"]][] = [
  [new RegExp(`^key/T${ORDINAL}/${NUMBER}\\.bin$`), "sidecar"],
  [new RegExp(`^key/T${ORDINAL}/Q${ORDINAL}/${NUMBER}\\.m4s$`), "key"],
  [new RegExp(`^state/L${ORDINAL}/${NUMBER}\\.m4s$`), "state"],
  [new RegExp(`^group/${NUMBER}\\.json\\.gz$`), "group"],
  [new RegExp(`^index/([1-9])/${NUMBER}\\.json$`), "page"],
];

/** What a path names; null for a path that is none of these. */
export function locate(path: string): Location | null {
  for (const [pattern, what] of PATTERNS) {
    const match = pattern.exec(path);
    if (match) return { what, numbers: match.slice(1).map(Number) };
  }
  return null;
}

/** Page of the index; the level counts from 1 as well. */
export const pagePath = (level: number, number: number) => `index/${level}/${number}.json`;
/** Table of a group. */
export const groupPath = (number: number) => `group/${number}.json.gz`;
/** Sidecar of a key tier of a group, the same for all its qualities. */
export const keySidecarPath = (tier: number, number: number) => `key/T${tier}/${number}.bin`;
/** Picture of a key tier of a group in a quality. */
export const keyMediaPath = (tier: number, quality: number, number: number) => `key/T${tier}/Q${quality}/${number}.m4s`;
/** Pictures of a segment in a level. */
export const stateMediaPath = (level: number, number: number) => `state/L${level}/${number}.m4s`;

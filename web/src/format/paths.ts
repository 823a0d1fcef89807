// The files of a package by their paths: FORMAT.md, section 2. Numbers in paths count from 1.
import { PATHS } from "../generated/constants.ts";

/** What a path names, and the numbers in it, as they stand there. */
export interface Location {
  what: (typeof PATHS)[number][1];
  /** sidecar: tier, number; keyframe: tier, quality, number; delta, page: level, number; sound, group: number. */
  numbers: number[];
}

const PATTERNS = PATHS.map(([pattern, what]) => [new RegExp(pattern), what] as const);

/** Reads a path; null for one that is none of these. */
export function locate(path: string): Location | null {
  for (const [pattern, what] of PATTERNS) {
    const match = pattern.exec(path);
    if (match) return { what, numbers: match.slice(1).map(Number) };
  }
  return null;
}

export const soundPath = (number: number) => `sound/${number}.m4a`;
export const pagePath = (level: number, number: number) => `index/${level}/${number}.json`;
export const groupPath = (number: number) => `group/${number}.json.gz`;
/** Sidecar of a keyframe tier, the same for all qualities. */
export const keyframeSidecarPath = (tier: number, number: number) => `keyframe/T${tier}/${number}.bin`;
export const keyframeMediaPath = (tier: number, quality: number, number: number) =>
  `keyframe/T${tier}/Q${quality}/${number}.m4s`;
export const deltaMediaPath = (level: number, number: number) => `delta/L${level}/${number}.m4s`;

export const isPacked = (path: string): boolean => path.endsWith(".gz");
export const isPage = (path: string): boolean => locate(path)?.what === "page";
export const isSound = (path: string): boolean => locate(path)?.what === "sound";
export const isTable = (path: string): boolean => isPage(path) || locate(path)?.what === "group";

// The files of the repository, for tests.
import { readdirSync, readFileSync, statSync } from "node:fs";

/** The repository: tests run from web/out/unit. */
const ROOT = new URL("../../../", import.meta.url);

export const pathOf = (path: string) => new URL(path, ROOT);
export const readBytes = (path: string) => new Uint8Array(readFileSync(pathOf(path)));
export const readJson = (path: string) => JSON.parse(readFileSync(new URL(path, ROOT), "utf8"));
/** A file of manifests/vectors: lists of cases. */
export const readVectors = (name: string) => readJson(`manifests/vectors/${name}.json`);
export const folders = (path: string) =>
  readdirSync(new URL(path, ROOT), { withFileTypes: true })
    .filter((entry) => entry.isDirectory())
    .map((entry) => `${path}/${entry.name}`);
/** The files of a package by their paths. */
export type Files = ReadonlyMap<string, Uint8Array>;
export const readFiles = (folder: string): Files =>
  new Map(
    readdirSync(pathOf(folder), { recursive: true, encoding: "utf8" })
      .filter((path) => statSync(pathOf(`${folder}/${path}`)).isFile())
      .map((path) => [path, readBytes(`${folder}/${path}`)]),
  );
export const fromBase64 = (text: string) => new Uint8Array(Buffer.from(text, "base64"));

/** A number of two halves, as text. */
export const joined = (lo: number, hi: number) => ((BigInt(hi) << 32n) | BigInt(lo)).toString();
/** A list in which [number, count] stands for a run. */
export const runs = (list: unknown[]): unknown[] =>
  list.flatMap((item) => (Array.isArray(item) ? new Array(item[1]).fill(item[0]) : [item]));

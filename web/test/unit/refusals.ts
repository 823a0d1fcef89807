// The packages of manifests/invalid, whose README.md says how they are written.
import { readdirSync } from "node:fs";
import { type Files, fromBase64, pathOf, readFiles, readJson } from "./files.ts";

type Change = null | { data: string } | { replace: [string, string][] } | { spaces_to: number } | { link: string };

export interface Refusal {
  name: string;
  reason: string;
  where: string;
  files: Record<string, Change>;
}

function changed(files: Files, path: string, change: NonNullable<Change>): Uint8Array {
  if ("data" in change) return fromBase64(change.data);
  if ("link" in change) return files.get(new URL(change.link, `file:///${path}`).pathname.slice(1))!;
  const text = new TextDecoder().decode(files.get(path));
  if ("spaces_to" in change) return new TextEncoder().encode(text.padEnd(change.spaces_to));
  return new TextEncoder().encode(change.replace.reduce((now, [old, becomes]) => replaced(now, old, becomes), text));
}

function replaced(text: string, old: string, becomes: string): string {
  const parts = text.split(old);
  if (parts.length !== 2) throw new Error(`expected ${old} once`);
  return parts.join(becomes);
}

/** Every case, and the files of its package. */
export function refusals(): [Refusal, Files][] {
  return readdirSync(pathOf("manifests/invalid"))
    .filter((name) => name.endsWith(".json"))
    .flatMap((name) => {
      const base = readFiles(`manifests/valid/${name.replace(".json", "")}`);
      const { cases }: { cases: Refusal[] } = readJson(`manifests/invalid/${name}`);
      return cases.map((refusal): [Refusal, Files] => {
        const files = new Map(base);
        for (const [path, change] of Object.entries(refusal.files)) {
          if (change === null) files.delete(path);
          else files.set(path, changed(base, path, change));
        }
        return [refusal, files];
      });
    });
}

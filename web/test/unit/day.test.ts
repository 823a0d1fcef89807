// A day of live publishing, and a viewer who stays for it.
import assert from "node:assert/strict";
import { test } from "node:test";
import { gunzipSync, gzipSync } from "node:zlib";
import { Tables } from "../../src/format/package.ts";
import { locate } from "../../src/format/paths.ts";
import { PAGE } from "../../src/generated/constants.ts";
import type { Arrival } from "../../src/play/downloader.ts";
import { Offers } from "../../src/play/offers.ts";
import { TableStore } from "../../src/play/stores.ts";
import { readBytes, readJson } from "./files.ts";

const encode = (table: unknown) => new TextEncoder().encode(JSON.stringify(table));

/** Columns of parts, of so many groups of a frame each, from one on. */
function columns(level: number, first: number, count: number) {
  const numbers = Array.from({ length: count }, (_, i) => first + i);
  const sizes = numbers.map(() => PAGE ** level);
  return {
    frames: sizes,
    segments: sizes,
    bytes: sizes,
    sha256: numbers.map((n) => `${n}`.padStart(32, "A")).join(""),
  };
}

/** The index after so many groups. */
const digits = (count: number) =>
  Array.from({ length: Math.floor(Math.log(count) / Math.log(PAGE)) + 1 }, (_, level) => {
    const parts = Math.floor(count / PAGE ** level);
    return columns(level, parts - (parts % PAGE), parts % PAGE);
  });

test("a viewer who stays for a day of groups of a second, looking each minute, has no more tables at its end", async () => {
  const folder = "manifests/valid/paged";
  const root = readJson(`${folder}/airgs.json`);
  const group = JSON.parse(gunzipSync(readBytes(`${folder}/group/1.json.gz`)).toString());
  const grown = (count: number) => encode({ ...root, live: true, frames: count, index: digits(count) });
  const tables = Tables.parse(grown(63));
  const offers = new Offers(tables);
  offers.first = 62;
  const store = new TableStore(offers);
  const come = async (path: string) => {
    const { what, numbers } = locate(path)!;
    const [level, number] = [numbers[0]!, numbers.at(-1)! - 1];
    if (what === "page") tables.addPage(path, encode(columns(level - 1, PAGE * number, PAGE)));
    else {
      const segments = [{ ...group.segments[0], start: number, stop: number + 1 }];
      await tables.addGroup(number, gzipSync(JSON.stringify({ ...group, start: number, stop: number + 1, segments })));
    }
    const batch = { keyframes: [], delta: [], tables: [path] };
    store.add({ request: { batch }, whole: [path], refused: new Map() } as unknown as Arrival);
  };
  const pages = (upTo: number) => {
    const paths = [1, 2].flatMap((level) =>
      Array.from({ length: Math.floor(upTo / PAGE ** level) }, (_, n) => `index/${level}/${n + 1}.json`),
    );
    return paths.filter((path) => tables.index.hasPage(path)).length;
  };
  for (let count = 63; count <= 86_400; count += 60) {
    const position = count - 63;
    tables.grow(grown(count));
    for (
      let paths = store.missing(position, position + 1);
      paths.length;
      paths = store.missing(position, position + 1)
    ) {
      for (const path of paths) await come(path);
    }
    assert.ok(store.has(position));
  }
  assert.ok(pages(86_400) <= 256, `${pages(86_400)} pages`);
  const groups = Array.from({ length: 86_400 }, (_, n) => n).filter((n) => tables.has(n)).length;
  assert.ok(groups <= 1024, `${groups} tables`);
  assert.ok(tables.rootBytes < 10_000);
  assert.ok(!store.has(0)); // it would be fetched again
});

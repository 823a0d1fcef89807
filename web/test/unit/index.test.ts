// The index of long packages: numbers in base 64, and what happens where a level is carried.
import assert from "node:assert/strict";
import { test } from "node:test";
import { GroupIndex, MissingTableError } from "../../src/format/index.ts";
import { Tables } from "../../src/format/package.ts";
import { groupPath, locate, pagePath } from "../../src/format/paths.ts";
import type { Page } from "../../src/format/types.ts";
import { PAGE } from "../../src/generated/constants.ts";
import { readJson, readVectors } from "./files.ts";

const sum = (numbers: number[]) => numbers.reduce((a, b) => a + b, 0);
const digestOf = (name: string) => name.replaceAll(/[./]/g, "_").padEnd(32, "_");

/** Columns of parts whose files are those of `paths`. */
function columns(parts: Page[], paths: string[]): Page {
  const counts = { frames: parts.map(({ frames }) => sum(frames)), segments: parts.map((part) => sum(part.segments)) };
  return { ...counts, bytes: parts.map(() => 7), sha256: paths.map(digestOf).join("") };
}

/** The index of so many groups of a frame, and all its pages by their paths. */
function longIndex(count: number) {
  const one: Page = { frames: [1], segments: [1], bytes: [7], sha256: "" };
  const index: Page[] = [];
  const pages = new Map<string, Page>();
  let below: Page[] = new Array(count).fill(one);
  for (let level = 0; below.length; level++) {
    const path = (number: number) => (level ? pagePath(level, number) : groupPath(number));
    const full = below.length - (below.length % PAGE);
    const paths = below.map((_, place) => path(place + 1));
    index.push(columns(below.slice(full), paths.slice(full)));
    const above = Array.from({ length: full / PAGE }, (_, n) => {
      const [start, stop] = [PAGE * n, PAGE * (n + 1)];
      return columns(below.slice(start, stop), paths.slice(start, stop));
    });
    above.forEach((page, n) => {
      pages.set(pagePath(level + 1, n + 1), page);
    });
    below = above;
  }
  return { index, pages };
}

/** All steps to a frame: pages that were missing are added as they are asked for. */
function read(places: GroupIndex, pages: Map<string, Page>, frame: number): string[] {
  const asked: string[] = [];
  for (;;) {
    try {
      places.groupAt("frames", frame);
      return asked;
    } catch (error) {
      assert.ok(error instanceof MissingTableError);
      asked.push(error.path);
      places.addPage(error.path, pages.get(error.path)!);
    }
  }
}

for (const one of readVectors("packages").index) {
  test(`the way to group ${one.number} of ${one.count}`, () => {
    const { index, pages } = longIndex(one.count);
    assert.deepEqual(
      index.map(({ frames }) => frames.length),
      one.entries,
    );
    const places = new GroupIndex(index);
    assert.equal(places.leadsTo(one.frame), !one.pages.length);
    assert.deepEqual(read(places, pages, one.frame), one.pages);
    const group = one.number - 1;
    assert.deepEqual(
      [places.groups, places.groupAt("frames", one.frame), places.groupAt("segments", one.frame)],
      [one.count, group, group],
    );
    assert.deepEqual([...places.pagesTo("segments", group)], one.pages);
    assert.equal(places.entry(group).file.sha256, digestOf(groupPath(one.number)));
    assert.deepEqual(places.guessSpan(one.frame), { start: one.frame, stop: one.frame + 1 });
  });
}

test("a segment under a page that is not there is guessed", () => {
  const { index, pages } = longIndex(4097);
  const places = new GroupIndex(index);
  assert.deepEqual(places.guessSpan(4000), { start: 4000, stop: 4001 });
  assert.throws(() => places.pageEntry(pagePath(1, 1)), MissingTableError);
  assert.throws(() => places.pageEntry(pagePath(2, 2)), RangeError);
  places.addPage(pagePath(2, 1), pages.get(pagePath(2, 1))!);
  assert.equal(places.pageEntry(pagePath(1, 2)).start, 64);
  assert.deepEqual([places.hasPage(pagePath(1, 1)), places.leadsTo(0), places.leadsTo(4096)], [false, false, true]);
  for (const wrong of [-1, 4097, Number.NaN]) assert.throws(() => places.entry(wrong), RangeError);
});

const encode = (table: unknown) => new TextEncoder().encode(JSON.stringify(table));

/** airgs.json of so many groups. */
function rootOf(count: number, change: (index: Page[]) => void = () => {}) {
  const { index } = longIndex(count);
  change(index);
  return encode({ ...readJson("manifests/valid/paged/airgs.json"), live: true, frames: count, index });
}

test("a package grows past the second level, and what it was is expected of its pages", () => {
  const tables = Tables.parse(rootOf(63));
  const { pages } = longIndex(4096);
  const add = (path: string) => tables.addPage(path, encode(pages.get(path)!));
  for (const count of [64, 66, 127, 192, 4095]) tables.grow(rootOf(count));
  for (const number of [1, 2, 3, 63]) add(pagePath(1, number));
  assert.equal(tables.groupOf(64), 64);
  tables.grow(rootOf(4096));
  assert.throws(() => tables.groupOf(64), MissingTableError);
  const path = pagePath(2, 1);
  const other = { ...pages.get(path)!, sha256: `x${pages.get(path)!.sha256.slice(1)}` };
  assert.throws(() => tables.addPage(path, encode(other)), { reason: "bad_value" });
  add(path);
  assert.equal(tables.groupOf(64), 64); // page 2 of the first level is still there
  assert.throws(() => tables.groupOf(4095), MissingTableError);
  tables.grow(rootOf(4097));
  add(pagePath(1, 64));
  assert.deepEqual([tables.groupOf(4095), tables.groupOf(4096)], [4095, 4096]);
});

test("another index is no growth", () => {
  const spoil = (level: number) => (index: Page[]) => {
    index[level]!.sha256 = `x${index[level]!.sha256.slice(1)}`;
  };
  const others = [rootOf(4099, spoil(0)), rootOf(4200, spoil(2)), rootOf(4226, spoil(1)), rootOf(4000), rootOf(70)];
  for (const other of others) {
    const tables = Tables.parse(rootOf(4162));
    assert.throws(() => tables.grow(other), { reason: "bad_value" });
  }
  Tables.parse(rootOf(4162)).grow(rootOf(4226));
});

test("a page has what the level above says of it", () => {
  const { pages } = longIndex(4100);
  const path = pagePath(2, 1);
  const page = pages.get(path)!;
  const broken: Partial<Page>[] = [
    { frames: [65, ...page.frames.slice(1)] },
    { segments: [63, ...page.segments.slice(1)] },
    { sha256: page.sha256.slice(32) },
    ...[{ frames: [128, ...page.frames.slice(2)], segments: [128, ...page.segments.slice(2)] }].map((sums) => ({
      ...sums,
      bytes: page.bytes.slice(1),
      sha256: page.sha256.slice(32),
    })),
  ];
  for (const part of broken) {
    const tables = Tables.parse(rootOf(4100));
    assert.throws(() => tables.addPage(path, encode({ ...page, ...part })), { reason: "bad_value" });
  }
});

test("an index whose levels cannot be is refused", () => {
  const none: Page = { frames: [], segments: [], bytes: [], sha256: "" };
  const changes: ((index: Page[]) => void)[] = [
    (index) => index.push(none),
    (index) => index.push(none, none, none, none),
    (index) => index.splice(0),
    (index) => index.splice(1, 0, none), // the page is said to be of the second level
    (index) => index.splice(0, 1, columns(new Array(65).fill({ ...none, frames: [1], segments: [1] }), [])),
  ];
  for (const change of changes) assert.throws(() => Tables.parse(rootOf(65, change)), { reason: "bad_value" });
  assert.deepEqual(locate("index/2/1.json"), { what: "page", numbers: [2, 1] });
});

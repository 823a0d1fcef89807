import assert from "node:assert/strict";
import { test } from "node:test";
import { gzipSync } from "node:zlib";
import { Ajv2020 } from "ajv/dist/2020.js";
import { FormatError } from "../../src/format/errors.ts";
import { MissingTableError } from "../../src/format/index.ts";
import { Tables } from "../../src/format/package.ts";
import { checkTable, inflate } from "../../src/format/parse.ts";
import {
  deltaMediaPath,
  groupPath,
  keyframeMediaPath,
  keyframeSidecarPath,
  locate,
  pagePath,
} from "../../src/format/paths.ts";
import { group, page, root } from "../../src/generated/schema.ts";
import { readBytes, readJson, readVectors } from "./files.ts";
import { readTables } from "./walk.ts";

type Json = Record<string, unknown>;
const encode = (table: unknown) => new TextEncoder().encode(JSON.stringify(table));

/** Every place in a table: the object or list that holds it, and its name there. */
function* places(node: unknown): Generator<[Json, string]> {
  if (node === null || typeof node !== "object") return;
  for (const name of Object.keys(node)) {
    yield [node as Json, name];
    yield* places((node as Json)[name]);
  }
}

/** What a value is replaced with: other types, and numbers about the ends of ranges. */
const OTHERS = [null, true, 0, -1, 1, 0.5, 2, 3, 16, 4097, 2 ** 31, 2 ** 31 + 1, 1e300, "", "x", [], [1], {}, { x: 1 }];

/** The table with one value replaced or taken away: the same object every time, which is whole again after it. */
function* mutations(table: Json): Generator<Json> {
  for (const [holder, name] of [...places(table)]) {
    const before = holder[name];
    for (const other of OTHERS) {
      holder[name] = other;
      yield table;
    }
    holder[name] = before;
    if (Array.isArray(holder)) {
      holder.splice(Number(name), 1);
      yield table;
      holder.splice(Number(name), 0, before);
    } else {
      delete holder[name];
      yield table;
      holder[name] = before;
    }
  }
  yield { ...table, another: 1 };
}

/** A table with lists of at most two items, which keeps mutations few. */
const short = (node: unknown): unknown => {
  if (Array.isArray(node)) return node.slice(0, node.length === 3 ? 3 : 2).map(short);
  if (node === null || typeof node !== "object") return node;
  return Object.fromEntries(Object.entries(node).map(([name, one]) => [name, short(one)]));
};

function verdict(value: unknown, schema: Json): string | null {
  try {
    checkTable(value, schema, "table");
    return null;
  } catch (error) {
    assert.ok(error instanceof FormatError, String(error));
    return error.reason;
  }
}

test("tables are refused where a validator of JSON Schema refuses them", async () => {
  const { $defs, ...whole } = readJson("manifests/airgs.schema.json") as Json & { $defs: Record<string, Json> };
  const table = (await readTables("manifests/valid/moving")).group(0);
  const paged = readJson("manifests/valid/paged/index/1/1.json");
  const all: [Json, Json, unknown][] = [
    [whole, root, readJson("manifests/valid/moving/airgs.json")],
    [$defs.group, group, table],
    [$defs.page, page, paged],
  ];
  for (const [standard, schema, valid] of all) {
    const judge = new Ajv2020({ strict: false }).compile(standard);
    const reasons = new Set<string | null>();
    const compare = (one: unknown) => {
      const found = verdict(one, schema);
      reasons.add(found);
      assert.equal(found === null, judge(one), JSON.stringify(judge.errors));
    };
    compare(valid);
    for (const one of mutations(short(valid) as Json)) compare(one);
    assert.deepEqual([...reasons].sort(), ["bad_value", "missing_field", null, "unknown_field", "wrong_type"].sort());
  }
});

test("a keyword of the schema that is not known is an error", () => {
  assert.throws(() => checkTable([1, 1], { type: "array", uniqueItems: true }, "x"), /keyword uniqueItems/);
});

test("numbers that JSON can write and no float holds are refused", () => {
  assert.equal(verdict(JSON.parse("1e999"), { type: "number" }), "bad_value");
});

test("names of an object's own past are fields like others", () => {
  const schema = { properties: {}, optional: [] };
  assert.equal(verdict(JSON.parse('{"__proto__": 1}'), schema), "unknown_field");
  assert.equal(verdict({}, { ...schema, properties: { toString: { type: "string" } } }), "missing_field");
});

test("paths", () => {
  const paths: [string, string, number[]][] = [
    [pagePath(2, 7), "page", [2, 7]],
    [groupPath(1), "group", [1]],
    [keyframeSidecarPath(0, 12), "sidecar", [0, 12]],
    [keyframeMediaPath(63, 1, 9_999_999), "keyframe", [63, 1, 9_999_999]],
    [deltaMediaPath(10, 3), "delta", [10, 3]],
  ];
  for (const [path, what, numbers] of paths) assert.deepEqual(locate(path), { what, numbers });
  const strange = [
    "index/1/0.json",
    "index/0/1.json",
    "index/10/1.json",
    "index/1.json",
    "group/01.json.gz",
    "keyframe/T00/1.bin",
    "keyframe/T0/1.bin\n",
    "/group/1.json.gz",
    "delta/L100/1.m4s",
    "delta/P0/L0/1.m4s",
  ];
  for (const path of [...strange, "airgs.json", "../group/1.json.gz"]) assert.equal(locate(path), null, path);
});

for (const one of readVectors("packages").groups) {
  test(`files of group ${one.number} of ${one.package}`, async () => {
    const tables = await readTables(one.package);
    const number = one.number - 1;
    const { start, stop } = tables.index.entry(number);
    assert.deepEqual([start, stop], [one.start, one.stop]);
    assert.deepEqual([...tables.index.pagesTo("groups", number)], one.pages);
    assert.equal(groupPath(one.number), one.table);
    const { tiers, qualities, levels } = tables.root;
    for (let tier = 0; tier < tiers; tier++) {
      for (let quality = 0; quality < qualities.length; quality++) {
        const expected = [one.sidecars[tier], one.pictures[tier][quality]].filter((path) => path !== null);
        assert.deepEqual(tables.keyframeFiles(number, tier, quality), expected);
      }
    }
    const all = tables.segmentsOf(number);
    assert.equal(all.stop - all.start, one.segments.length);
    one.segments.forEach((expected: { start: number; stop: number; files: (string | null)[] }, s: number) => {
      const segment = all.start + s;
      assert.deepEqual([tables.segment(segment).start, tables.segment(segment).stop], [expected.start, expected.stop]);
      assert.equal(tables.groupOf(segment), number);
      for (let frame = expected.start; frame < expected.stop; frame++) assert.equal(tables.segmentAt(frame), segment);
      levels.forEach((_, level) => {
        assert.deepEqual(
          tables.deltaFiles(segment, level),
          [expected.files[level]].flatMap((path) => path ?? []),
        );
      });
    });
  });
}

for (const one of readVectors("packages").startup) {
  test(`what shows frame ${one.frame} of ${one.package} at Q${one.quality} L${one.level} of ${one.tiers}`, async () => {
    const read = (path: string) => readBytes(`${one.package}/${path}`);
    const tables = Tables.parse(read("airgs.json"));
    const files = ["airgs.json"];
    const add = async (path: string) => {
      files.push(path);
      await tables.add(path, read(path));
    };
    try {
      tables.index.groupAt("frames", one.frame);
    } catch (error) {
      assert.ok(error instanceof MissingTableError);
      await add(error.path);
    }
    const number = tables.index.groupAt("frames", one.frame);
    assert.throws(() => tables.group(number), MissingTableError);
    await add(groupPath(number + 1));
    const { base } = tables.group(number);
    if (base) await add(groupPath(base));
    files.push(...tables.keyframesOf(number, one.quality, one.tiers));
    files.push(...tables.deltaFiles(tables.segmentAt(one.frame), one.level));
    assert.deepEqual(files, one.files);
  });
}

test("files that no table has are asked for in vain", async () => {
  const tables = await readTables("manifests/valid/one-gaussian");
  const strange = [
    "keyframe/T1/1.bin",
    "keyframe/T9/1.bin",
    "keyframe/T0/Q9/1.m4s",
    "delta/L0/1.m4s",
    "delta/L0/9.m4s",
    "delta/P1/L0/1.m4s",
    "group/2.json.gz",
  ];
  for (const path of [...strange, "index/1/1.json", "index/9/1.json", "airgs.json", "manifest.mpd", "x"]) {
    assert.throws(() => tables.entry(path), { reason: "missing_entry" }, path);
  }
  assert.equal(tables.entry("init.mp4").bytes, 637);
});

test("the segments of an unread page are guessed, and found once it is read", async () => {
  const folder = "manifests/valid/paged";
  const { index } = Tables.parse(readBytes(`${folder}/airgs.json`));
  const whole = (await readTables(folder)).index;
  const page = pagePath(1, 1);
  assert.deepEqual([...whole.pagesTo("segments", 0)], [page]);
  assert.deepEqual([index.hasPage(page), whole.hasPage(page)], [false, true]);
  assert.deepEqual([index.leadsTo(0), whole.leadsTo(0), index.leadsTo(64)], [false, true, true]);
  assert.throws(() => index.entry(0), MissingTableError);
  let stop = 0;
  for (let segment = 0; segment < index.segments; segment++) {
    const guess = index.guessSpan(segment);
    assert.equal(guess.start, stop);
    stop = guess.stop;
  }
  assert.equal(stop, index.frames);
  for (const wrong of [-1, index.segments, Number.NaN])
    assert.throws(() => index.groupAt("segments", wrong), RangeError);
});

test("a keyframe with rows and no plane is refused", async () => {
  const tables = await readTables("tests/golden/fox");
  const table = structuredClone(tables.group(0));
  table.tiers[0]!.qualities[0]!.planes = [];
  const bytes = new Uint8Array(gzipSync(encode(table)));
  await assert.rejects(
    tables.addGroup(0, bytes),
    (error) => error instanceof FormatError && error.reason === "bad_value",
  );
});

test("what stands behind a member of gzip is refused, and what is cut off", async () => {
  const one = new Uint8Array(gzipSync("{}"));
  assert.equal(new TextDecoder().decode(await inflate(one, "x")), "{}");
  const more = [Uint8Array.of(...one, 0), Uint8Array.of(...one, ...one), one.subarray(0, -1), new Uint8Array(0)];
  for (const data of more) await assert.rejects(inflate(data, "x"), { reason: "not_json" });
});

test("a table that would cost far more than its file is refused before it is built", async () => {
  const table = await readTables("tests/golden/fox");
  for (const tail of ["[],".repeat(1 << 21), " ".repeat(1 << 24)]) {
    const bytes = new Uint8Array(gzipSync(`{"repairs":[${tail}1]}`));
    await assert.rejects(table.addGroup(0, bytes), { reason: "too_large" });
  }
});

test("half of a surrogate pair is no text", () => {
  checkTable("\ud83e\udd8a", { type: "string" }, "x");
  assert.throws(() => checkTable("\ud800", { type: "string" }, "x"), { reason: "bad_value" });
});

/** The root of `paged` as it was when it had this many groups after no page. */
function younger(groups: number): Json {
  const root = readJson("manifests/valid/paged/airgs.json");
  const spans = readJson("manifests/valid/paged/index/1/1.json");
  const first = (list: number[]) => list.slice(0, groups);
  const { frames, segments, bytes, sha256 } = spans;
  const kept = {
    frames: first(frames),
    segments: first(segments),
    bytes: first(bytes),
    sha256: sha256.slice(0, 32 * groups),
  };
  const count = kept.frames.reduce((sum: number, one: number) => sum + one, 0);
  return { ...root, live: true, frames: count, index: [kept] };
}

test("a package grows, and its groups move to a page", async () => {
  const folder = "manifests/valid/paged";
  const tables = Tables.parse(encode(younger(3)));
  await tables.add(groupPath(1), readBytes(`${folder}/${groupPath(1)}`));
  tables.grow(encode({ ...younger(5), decisions: ["one more"] }));
  assert.equal(tables.index.groups, 5);
  assert.ok(tables.has(0));
  tables.grow(encode({ ...readJson(`${folder}/airgs.json`), decisions: [] }));
  assert.equal(tables.root.live, false);
  assert.throws(() => tables.groupOf(0), MissingTableError);
  await tables.add(pagePath(1, 1), readBytes(`${folder}/${pagePath(1, 1)}`));
  assert.equal(tables.groupOf(0), 0);
  assert.ok(tables.has(0));
  tables.grow(encode({ ...readJson(`${folder}/airgs.json`) }));
  assert.equal(tables.groupOf(0), 0);
});

test("another package is no growth", async () => {
  const folder = "manifests/valid/paged";
  const grown = () => {
    const tables = Tables.parse(encode(younger(3)));
    return (next: Json) => assert.throws(() => tables.grow(encode(next)), { reason: "bad_value" });
  };
  const refuse = grown();
  refuse(younger(2));
  refuse({ ...younger(5), attribution: "of somebody else" });
  refuse({ ...younger(5), init: { bytes: 1, sha256: "A".repeat(32) } });
  const other = younger(5) as { index: { sha256: string }[] };
  other.index[0]!.sha256 = `_${other.index[0]!.sha256.slice(1)}`;
  refuse(other);
  const ended = Tables.parse(encode({ ...younger(3), live: false }));
  assert.throws(() => ended.grow(encode(younger(3))), { reason: "bad_value" });
  const before = younger(3) as { index: { sha256: string }[] };
  before.index[0]!.sha256 = `_${before.index[0]!.sha256.slice(1)}`;
  const tables = Tables.parse(encode(before));
  tables.grow(readBytes(`${folder}/airgs.json`));
  await assert.rejects(tables.add(pagePath(1, 1), readBytes(`${folder}/${pagePath(1, 1)}`)), { reason: "bad_value" });
});

test("the tables of groups that were used last are kept", async () => {
  const tables = await readTables("tests/golden/fox");
  const bytes = readBytes("tests/golden/fox/group/1.json.gz");
  const first = tables.group(0);
  const entry = { ...tables.index.entry(0) };
  tables.index.entry = () => entry; // as many groups as one likes
  for (let number = 1; number <= 1024; number++) await tables.addGroup(number, bytes);
  assert.ok(!tables.has(0));
  assert.throws(() => tables.group(0), MissingTableError);
  assert.deepEqual(tables.group(1), first);
  await tables.addGroup(1025, bytes);
  assert.ok(tables.has(1) && !tables.has(2));
});

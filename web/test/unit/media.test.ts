import assert from "node:assert/strict";
import { test } from "node:test";
import { annexB, codecOf, nalUnits, pageSamples } from "../../src/format/avc.ts";
import { FormatError } from "../../src/format/errors.ts";
import { checkCount, readDeltas, readKeyframeTier } from "../../src/format/files.ts";
import { type Media, readMedia } from "../../src/format/mp4.ts";
import type { Tables } from "../../src/format/package.ts";
import { locate } from "../../src/format/paths.ts";
import type { Atlas } from "../../src/format/types.ts";
import { OWN_UUID } from "../../src/generated/constants.ts";
import { readBytes, readVectors } from "./files.ts";
import { readTables } from "./walk.ts";

const refused = { name: "FormatError", reason: "bad_picture" };
const FOX = "tests/golden/fox";
const KEYFRAME = "keyframe/T0/Q0/1.m4s";
const open = (path: string, folder = FOX): Media => readMedia(readBytes(`${folder}/${path}`), path);

/** Atlas, frames and span of a file. */
function placeOf(tables: Tables, path: string): { atlas: Atlas; start: number; stop: number } {
  const { what, numbers } = locate(path)!;
  const number = numbers.at(-1)! - 1;
  const [first, second] = numbers as [number, number];
  if (what === "delta") {
    const { start, stop } = tables.segment(number);
    return { atlas: tables.group(tables.groupOf(number)).levels[first]!, start, stop };
  }
  const { tiers, start, stop } = tables.group(number);
  return { atlas: tiers[first]!.qualities[second]!, start, stop };
}

for (const one of readVectors("packages").units) {
  test(`${one.path} of ${one.package}`, async () => {
    const tables = await readTables(one.package);
    const { checksums, columns, samples } = open(one.path, one.package);
    assert.equal(columns && Buffer.from(columns).toString("base64"), one.columns);
    assert.equal(checksums.length, samples.length);
    const { atlas, start, stop } = placeOf(tables, one.path);
    const frames = one.path.startsWith("keyframe") ? 1 : stop - start;
    const pages = pageSamples(samples, atlas, frames, one.path);
    // `height` is that of the atlas' pages together.
    assert.deepEqual([pages.length * frames, atlas.width], [one.luma.length * pages.length, one.width]);
    assert.equal(pages.length * atlas.height, one.height);
    assert.match(codecOf(samples[0]!.data, one.path), /^avc1\.6400[0-9A-F]{2}$/);
  });

  test(`times of ${one.path} of ${one.package}`, async () => {
    const tables = await readTables(one.package);
    const { start, stop } = placeOf(tables, one.path);
    const ticks = (tables.root.timescale * tables.root.frame_rate[1]!) / tables.root.frame_rate[0]!;
    const { samples } = open(one.path, one.package);
    const shown = [...samples].sort((a, b) => a.time - b.time);
    let time = start * ticks;
    for (const sample of shown) {
      assert.equal(sample.time, time);
      time += sample.duration;
    }
    assert.equal(time, stop * ticks);
  });
}

test("a sample as Annex B has the same NAL units behind start codes", () => {
  const [sample] = open(KEYFRAME).samples;
  const stream = Buffer.from(annexB(sample!.data, KEYFRAME));
  const expected = nalUnits(sample!.data, KEYFRAME).flatMap((unit) => [0, 0, 0, 1, ...unit]);
  assert.deepEqual([...stream], expected);
});

test("another number of pictures is refused", async () => {
  const { atlas } = placeOf(await readTables(FOX), KEYFRAME);
  const { samples } = open(KEYFRAME);
  assert.throws(() => pageSamples([], atlas, 1, KEYFRAME), refused);
  assert.throws(() => pageSamples([...samples, ...samples], atlas, 1, KEYFRAME), refused);
});

test("a sample without parameter sets, or that is no IDR, is refused", async () => {
  const { atlas, start, stop } = placeOf(await readTables(FOX), "delta/L0/1.m4s");
  const { samples } = open("delta/L0/1.m4s");
  assert.throws(() => pageSamples([...samples].reverse(), atlas, stop - start, "x"), refused);
  const unit = nalUnits(samples[0]!.data, "x").find((one) => (one[0]! & 31) === 5)!;
  assert.throws(() => codecOf(Uint8Array.of(0, 0, 0, 1, unit[0]!), "x"), refused);
});

test("a sample of another profile, which may have other chroma and depths, is refused", () => {
  const sampleOf = (profile: number) => Uint8Array.of(0, 0, 0, 4, 0x67, profile, 64, 31);
  assert.equal(codecOf(sampleOf(77), "x"), "avc1.4D401F");
  for (const profile of [110, 122, 244]) assert.throws(() => codecOf(sampleOf(profile), "x"), refused);
});

/** A box of a kind with content. */
function box(kind: string, ...content: Uint8Array[]): Uint8Array {
  const data = content.flatMap((part) => [...part]);
  const header = Buffer.alloc(8);
  header.writeUInt32BE(8 + data.length);
  header.write(kind, 4, "latin1");
  return Uint8Array.from([...header, ...data]);
}

const words = (...numbers: number[]) => {
  const view = new DataView(new ArrayBuffer(4 * numbers.length));
  numbers.forEach((number, i) => {
    view.setUint32(4 * i, number);
  });
  return new Uint8Array(view.buffer);
};

test("every field that a fragment may have is read", () => {
  const tfhd = box("tfhd", words(0x1b, 1, 0, 0, 7, 50, 3));
  const tfdt = box("tfdt", words(1 << 24, 2, 5));
  const run = [words((1 << 24) | 0xf05, 2), words(0, 0), words(10, 2, 0, 0xffffffff), words(11, 1, 0, 4)];
  const moofBytes = 8 + 16 + 8 + tfhd.length + tfdt.length + 8 + run.reduce((sum, part) => sum + part.length, 0);
  run[1] = words(moofBytes + 8, 0);
  const traf = box("traf", tfhd, tfdt, box("trun", ...run));
  const own = box("uuid", Buffer.from(OWN_UUID, "hex"), words(7, 8), Uint8Array.of(9));
  const media = [...own, ...box("moof", box("mfhd", words(0, 1)), traf), ...box("mdat", Uint8Array.of(1, 2, 3))];
  const { checksums, columns, samples } = readMedia(Uint8Array.from(media), "x");
  assert.deepEqual([[...checksums], [...columns!]], [[7, 8], [9]]);
  const start = 2 * 2 ** 32 + 5;
  assert.deepEqual(samples, [
    { data: Uint8Array.of(1, 2), time: start - 1, duration: 10 },
    { data: Uint8Array.of(3), time: start + 14, duration: 11 },
  ]);
});

test("segments that are built otherwise are refused", () => {
  const whole = readBytes(`${FOX}/${KEYFRAME}`);
  const own = new DataView(whole.buffer).getUint32(0);
  const [uuid, fragment] = [whole.subarray(0, own), whole.subarray(own)];
  const other = whole.slice();
  other[8]! ^= 1;
  const free = box("free");
  const all = [
    [fragment, uuid],
    [uuid, uuid, fragment],
    [uuid, fragment, fragment],
    [free, fragment],
    [fragment, free],
    [other],
    [uuid],
    [box("uuid", Uint8Array.of(1)), fragment],
    [box("uuid", Buffer.from(OWN_UUID, "hex"), Uint8Array.of(0, 0, 0)), fragment], // a checksum is missing
    [fragment],
    [],
  ];
  for (const parts of all) {
    assert.throws(() => readMedia(Uint8Array.from(parts.flatMap((part) => [...part])), "x"), refused);
  }
});

test("a damaged file is refused for a reason of the format, wherever it is damaged", async () => {
  const tables = await readTables(FOX);
  const table = tables.group(0);
  const sidecar = readBytes(`${FOX}/keyframe/T0/1.bin`);
  const place = { group: 0, tier: 0, quality: 0 };
  const attempts: [Uint8Array, (data: Uint8Array) => void][] = [
    [sidecar, (data) => readKeyframeTier(tables.root, table, place, data, readBytes(`${FOX}/${KEYFRAME}`))],
    [readBytes(`${FOX}/${KEYFRAME}`), (data) => readKeyframeTier(tables.root, table, place, sidecar, data)],
    [readBytes(`${FOX}/delta/L0/1.m4s`), (data) => readDeltas(table, { segment: 0, place: 0, level: 0 }, data)],
  ];
  let refusals = 0;
  for (const [data, read] of attempts) {
    for (let at = 0; at < data.length; at += 7) {
      const damaged = data.slice();
      damaged[at]! ^= 1 << (at % 8);
      for (const one of [damaged, data.subarray(0, at)]) {
        try {
          read(one);
        } catch (error) {
          assert.ok(error instanceof FormatError, `byte ${at}: ${error}`);
          refusals++;
        }
      }
    }
  }
  assert.ok(refusals > 100);
});

test("rows of fewer tiers than a level asks for are some of its rows, of all tiers all of them", async () => {
  const tables = await readTables(FOX);
  const [root, table] = [tables.root, tables.group(0)];
  const rows = table.levels[0]!.rows;
  checkCount(root, table, 0, root.tiers, new Uint8Array(rows));
  checkCount(root, table, 0, root.tiers - 1, new Uint8Array(rows - 1));
  const mismatch = { reason: "count_mismatch" };
  assert.throws(() => checkCount(root, table, 0, root.tiers, new Uint8Array(rows - 1)), mismatch);
  assert.throws(() => checkCount(root, table, 0, root.tiers - 1, new Uint8Array(rows + 1)), mismatch);
});

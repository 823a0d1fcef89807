// Keyframes that are differences: FORMAT.md. Sidecars are written by hand, tables are those of the fox, changed in group 2.
import assert from "node:assert/strict";
import { test } from "node:test";
import { gzipSync } from "node:zlib";
import { canonicalGaussians } from "../../src/format/gaussians.ts";
import { Tables } from "../../src/format/package.ts";
import { groupPath } from "../../src/format/paths.ts";
import { readSidecar } from "../../src/format/sidecar.ts";
import type { Canonical, Group, KeyframePart } from "../../src/format/types.ts";
import { STATIC } from "../../src/generated/constants.ts";
import { type Column, columnFile } from "../support/range-encoder.ts";
import { fromBase64, readBytes, readVectors, runs } from "./files.ts";
import { readTables } from "./walk.ts";

const FOX = "tests/golden/fox";
const column = (order: 0 | 1, ...numbers: number[]): Column => ({ order, numbers });

for (const { name, data, columns } of readVectors("columns").cases) {
  const narrow = columns.map(({ order, numbers }: { order: 0 | 1; numbers: unknown[] }) =>
    column(order, ...runs(numbers).map(Number)),
  );
  if (narrow.some(({ numbers }: Column) => numbers.some((number) => number >= 2 ** 32))) continue;
  test(`columns written by hand are those of the encoder: ${name}`, () => {
    assert.deepEqual(columnFile(narrow), fromBase64(data));
  });
}

const GRID = { origin: [0, 0, 0], step: 1, finest: 0 };
const readDepths = (data: Uint8Array, count: number) => readSidecar(data, count, 0, GRID, 0, "file");

test("a sidecar of a difference has depths alone", () => {
  const { depths, classes } = readDepths(columnFile([column(1, 0, 1, 3)]), 3);
  assert.deepEqual([[...depths], classes.length], [[STATIC, 0, 2], 0]);
});

const positions = readVectors("positions");

for (const { name, rows, data, depths } of positions.inter) {
  test(`sidecar of the vectors: ${name}`, () => {
    assert.deepEqual([...readDepths(fromBase64(data), rows).depths], depths);
  });
}

for (const { name, rows, data } of positions.inter_refused) {
  test(`sidecar of the vectors refused: ${name}`, () => {
    assert.throws(() => readDepths(fromBase64(data), rows), { reason: "bad_sidecar" });
  });
}

// Tables

const NOTHING = { bytes: 0, sha256: "" };

/** The table of group 2 with keyframes that are differences to those of a group, of which some tiers have pictures. */
function keeping(earlier: Group, group: Group, base: number, pictures: boolean[]): Group {
  const { grid, keyframe_steps, colour_transform, count } = earlier;
  const table: Group = { ...structuredClone(group), grid, keyframe_steps, colour_transform, count, base };
  for (const [t, tier] of table.tiers.entries()) {
    const { count, factor } = earlier.tiers[t]!;
    Object.assign(tier, { count, factor });
    for (const atlas of tier.qualities) {
      atlas.centres.unshift(0, 0, 0);
      atlas.max_error.unshift(0);
      atlas.rows = pictures[t] ? count : 0;
      if (!pictures[t]) atlas.planes = [];
    }
    if (!pictures[t]) tier.pictures = tier.pictures.map(() => NOTHING);
  }
  return table;
}

const packed = (table: Group) => new Uint8Array(gzipSync(JSON.stringify(table)));

/** The tables of the fox, whose second keyframes are differences. */
async function fox(pictures: boolean[], base = 1): Promise<Tables> {
  const tables = await readTables(FOX);
  await tables.addGroup(1, packed(keeping(tables.group(0), tables.group(1), base, pictures)));
  return tables;
}

test("the files of a keyframe tier, and those of the base", async () => {
  const tables = await fox([true, false]);
  assert.deepEqual([tables.base(0), tables.base(1)], [null, 0]);
  assert.deepEqual(
    [tables.keyframeFiles(1, 0, 1), tables.keyframeFiles(1, 1, 1)],
    [["keyframe/T0/2.bin", "keyframe/T0/Q1/2.m4s"], ["keyframe/T1/2.bin"]],
  );
  assert.deepEqual(tables.keyframesOf(0, 0, 1), ["keyframe/T0/1.bin", "keyframe/T0/Q0/1.m4s"]);
  const files = [
    "keyframe/T0/2.bin",
    "keyframe/T0/Q1/2.m4s",
    "keyframe/T0/1.bin",
    "keyframe/T0/Q1/1.m4s",
    "keyframe/T1/2.bin",
  ];
  assert.deepEqual(tables.keyframesOf(1, 1, 2), [...files, "keyframe/T1/1.bin", "keyframe/T1/Q1/1.m4s"]);
});

test("a base must be there, keep none itself and be laid out alike, whichever is read first", async () => {
  const refused = { reason: "bad_value" };
  for (const keeps of [2, 3]) await assert.rejects(fox([true, false], keeps), refused, `of ${keeps}`);
  const tables = await fox([true, false]);
  const [first, second] = [tables.group(0), tables.group(1)];
  const { base, ...alone } = second;
  await assert.rejects(tables.addGroup(1, packed(alone)), refused); // channels of differences to nobody
  await assert.rejects(tables.addGroup(0, packed({ ...first, base: 1 })), refused); // of itself
  const changed: Record<string, (table: Group) => void> = {
    grid: (table) => Object.assign(table.grid, { finest: 3 }),
    keyframe_steps: (table) => Object.assign(table.keyframe_steps, { opacity: 0.5 }),
    colour_transform: (table) => Object.assign(table, { colour_transform: "" }),
    factor: (table) => Object.assign(table.tiers[1]!, { factor: 2.5 }),
  };
  for (const change of Object.values(changed)) {
    const other = structuredClone(second);
    change(other);
    await assert.rejects(tables.addGroup(1, packed(other)), { ...refused, message: /base/ });
    const base = structuredClone(first);
    change(base);
    await assert.rejects(tables.addGroup(0, packed(base)), { ...refused, message: /base/ });
  }
  const late = await readTables(FOX);
  const entry = late.index.entry(1);
  late.index.entry = () => entry;
  await late.addGroup(1, packed(second));
  await assert.rejects(late.addGroup(2, packed({ ...second, base: 2 })), refused); // of a group that has a base itself
});

test("without the table of the base nothing of it can be said", async () => {
  const read = (path: string) => readBytes(`${FOX}/${path}`);
  const whole = await fox([true, false]);
  const tables = Tables.parse(read("airgs.json"));
  await tables.addGroup(1, packed(whole.group(1)));
  assert.throws(() => tables.keyframesOf(1, 0, 1), /group\/1.json.gz has not been read/);
  await tables.add(groupPath(1), read(groupPath(1)));
  assert.deepEqual(tables.keyframesOf(1, 0, 1).slice(2), tables.keyframeFiles(0, 0, 0));
});

// Values

test("what differs is added to the base: scales, alpha and colours by sum, rotations by product", () => {
  const root = { keyframe_gain: 1, sh_degree: 0, qualities: [{ factor: 1 }] } as never;
  const whole = Int16Array.from([1, 0, 0, 0, 1, 0, 0, 0, 1], (number) => 32767 * number);
  const group = {
    keyframe_steps: { log_scales: 1, quaternions: Math.PI / 2, opacity: 0.5, sh_dc: 5, sh_rest: 1 },
    grid: { origin: [0, 0, 0], step: 1, finest: 0 },
    colour_transform: Buffer.from(whole.buffer).toString("base64"),
  } as unknown as Group;
  const rows = (numbers: number[]) => [0, 1, 2].map((row) => numbers.map((number) => row * number));
  const base = partOf(rows([1, 0, 0, 1, 0, 0, 2, 4, 5, 6]), 2);
  const difference = partOf(rows([7, 7, 7, 1, 0, 0, 0, 1, 0, 3, 1, 2, 3]), 2);
  const canonical: Canonical = {
    ...{ group: 1, quality: 0, tiers: 1 },
    means: new Float32Array(9).fill(9),
    units: new Float32Array(3).fill(1),
    depths: new Uint8Array(3),
    parts: [{ ...base, difference }],
  };
  const { means, quaternions, logScales, alpha, colours } = canonicalGaussians(root, group, canonical);
  assert.deepEqual([...means], new Array(9).fill(9)); // which have it already
  assert.deepEqual([...logScales.filter((_, i) => i % 3 === 0)], [0, 4, 8]);
  assert.deepEqual([...alpha], [0, 5, 10]);
  assert.deepEqual([...colours].map(Math.round), [0, 0, 0, 50, 70, 90, 100, 140, 180]);
  // Half a turn about x, then half a turn about y, is half a turn about z.
  assert.deepEqual(
    [...quaternions.subarray(4, 8)].map((value) => Math.round(value) + 0),
    [0, 0, 0, -1],
  );
});

/** A picture of codes by row and channel, one plane a channel below the other. */
function partOf(codes: number[][], factor = 1): KeyframePart {
  const planes = codes[0]!.map((_, channel) => channel);
  const luma = new Uint8Array(256 * planes.length).fill(128);
  const place = [0, 1, 16]; // of the first three rows
  for (const [row, numbers] of codes.entries()) {
    for (const [plane, code] of numbers.entries()) luma[256 * plane + place[row]!]! += code;
  }
  const size = { plane_width: 16, columns: 1, width: 16, height: 16 * planes.length };
  const atlas = { rows: codes.length, centres: planes.map(() => 0), planes, max_error: [], ...size };
  return { atlas, factor, luma, bases: null, difference: null };
}

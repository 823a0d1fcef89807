// Kept rows: FORMAT.md, section 3. Sidecars are written by hand, tables are those of the fox with rows kept in group 2.
import assert from "node:assert/strict";
import { test } from "node:test";
import { gzipSync } from "node:zlib";
import { canonicalGaussians } from "../../src/format/gaussians.ts";
import { Tables } from "../../src/format/package.ts";
import { groupPath } from "../../src/format/paths.ts";
import { ColumnReader } from "../../src/format/rangecoder.ts";
import { readSidecar } from "../../src/format/sidecar.ts";
import type { Canonical, Group, KeyPart } from "../../src/format/types.ts";
import { STATIC } from "../../src/generated/constants.ts";
import { type Positions, readPositions } from "../../src/media/tiles.ts";
import { type Column, columnFile } from "../support/range-encoder.ts";
import { fromBase64, joined, readBytes, readVectors, runs } from "./files.ts";
import { readTables } from "./walk.ts";

const FOX = "tests/golden/fox";
const GRID = { origin: [0, 0, 0], step: 1, bits: 4, finest: 0 };
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

/** Rows 1, 4 and 5 of six of the base, of which the first is static; then two rows of class 1 at (0, 0, 0) and (2, 0, 0). */
const KEPT = [column(1, 1, 2, 0), column(1, 0, 1, 3)];
const OTHERS = [column(0, 129), column(1, 0, 0), column(0, 0, 1), column(1, 2, 0)];

test("a sidecar begins with the rows that are kept", () => {
  const read = (columns: Column[], count: number, kept: number) =>
    readSidecar(columnFile(columns), { count, kept, base: 6 }, GRID, 0, "file");
  const both = read([...KEPT, ...OTHERS], 5, 3);
  assert.deepEqual([...both.kept], [1, 4, 5]);
  assert.deepEqual([...both.depths], [STATIC, 0, 2, 1, STATIC]);
  assert.deepEqual([...both.classes], [1, 1]);
  assert.deepEqual([...both.codes.lo], [0, 8]);
  const alone = read(KEPT, 3, 3);
  assert.deepEqual(
    [[...alone.kept], [...alone.depths]],
    [
      [1, 4, 5],
      [STATIC, 0, 2],
    ],
  );
  assert.equal(alone.classes.length, 0);
});

const WRONG: Record<string, [Column[], number, number]> = {
  "a row that the base does not have": [[column(1, 1, 2, 1), KEPT[1]!], 3, 3],
  "rows far beyond": [[column(1, 2 ** 32 - 1, 2 ** 32 - 1, 0), KEPT[1]!], 3, 3],
  "a depth that no byte holds": [[KEPT[0]!, column(1, 0, 1, 257)], 3, 3],
  "kept rows without others": [KEPT, 5, 3],
  "others where all are kept": [[...KEPT, ...OTHERS], 3, 3],
  "kept rows where none are": [[...KEPT, ...OTHERS], 2, 0],
};

for (const [name, [columns, count, kept]] of Object.entries(WRONG)) {
  test(`refused: ${name}`, () => {
    const read = () => readSidecar(columnFile(columns), { count, kept, base: 6 }, GRID, 0, "file");
    assert.throws(read, { reason: "bad_sidecar" });
  });
}

const positions = readVectors("positions");

for (const { name, grid, kept, there, rows, data, places, depths, codes, classes, others } of positions.kept) {
  test(`sidecar of the vectors: ${name}`, () => {
    const found = readSidecar(fromBase64(data), { count: kept + rows, kept, base: there }, grid, 0, "file");
    assert.deepEqual([[...found.kept], [...found.classes]], [places, classes]);
    assert.deepEqual([...found.depths], [...depths, ...others]);
    assert.deepEqual(
      [...found.codes.lo].map((low, i) => joined(low, found.codes.hi[i]!)),
      runs(codes),
    );
  });
}

for (const { name, grid, kept, there, rows, data } of positions.kept_refused) {
  test(`sidecar of the vectors refused: ${name}`, () => {
    const read = () => readSidecar(fromBase64(data), { count: kept + rows, kept, base: there }, grid, 0, "file");
    assert.throws(read, { reason: "bad_sidecar" });
  });
}

// Tables

const NOTHING = { bytes: 0, sha256: "" };

/** The table of group 2 with so many rows of each tier kept. */
function keeping(group: Group, keeps: number, kept: number[]): Group {
  const table: Group = { ...structuredClone(group), keeps };
  for (const [t, tier] of table.tiles[0]!.tiers.entries()) {
    tier.kept = kept[t]!;
    for (const atlas of tier.qualities) atlas.rows = tier.count - tier.kept;
    if (tier.count > tier.kept) continue;
    for (const atlas of tier.qualities) atlas.planes = [];
    tier.pictures = tier.pictures.map(() => NOTHING);
  }
  return table;
}

/** Tables of a group whose second tier has 139 rows, one less than before, and of one that keeps 140 of them. */
async function fewer(): Promise<{ base: Group; keeper: Group }> {
  const group = (await readTables(FOX)).group(1);
  const base = structuredClone(group);
  const { tiers } = base.tiles[0]!;
  tiers[0]!.count += 1;
  tiers[1]!.count -= 1;
  for (const tier of tiers) for (const atlas of tier.qualities) atlas.rows = tier.count;
  return { base, keeper: keeping(group, 2, [0, 140]) };
}

const packed = (table: Group) => new Uint8Array(gzipSync(JSON.stringify(table)));

/** The tables of the fox, of which group 2 keeps so many rows. */
async function fox(kept: number[], keeps = 1): Promise<Tables> {
  const tables = await readTables(FOX);
  await tables.addGroup(1, packed(keeping(tables.group(1), keeps, kept)));
  return tables;
}

test("the files of a key unit, and those of what it keeps", async () => {
  const tables = await fox([500, 140]);
  assert.deepEqual([tables.base(0), tables.base(1)], [null, 0]);
  assert.deepEqual(
    [tables.keyFiles(1, 0, 1), tables.keyFiles(1, 1, 1)],
    [["key/T0/2.bin", "key/T0/Q1/2.m4s"], ["key/T1/2.bin"]],
  );
  assert.deepEqual(tables.keptFiles(1, 1, 0), ["key/T1/1.bin", "key/T1/Q0/1.m4s"]);
  assert.deepEqual(tables.keptFiles(0, 1, 0), []);
  assert.deepEqual((await fox([500, 0])).keptFiles(1, 1, 0), []);
  const files = ["key/T0/2.bin", "key/T0/Q1/2.m4s", "key/T0/1.bin", "key/T0/Q1/1.m4s", "key/T1/2.bin"];
  assert.deepEqual(tables.keysOf(1, 1, [0, 1]), [...files, "key/T1/1.bin", "key/T1/Q1/1.m4s"]);
});

test("what is kept must be there", async () => {
  const refused = { reason: "bad_value" };
  for (const [kept, keeps] of [
    [[561, 0], 1],
    [[500, 0], 2],
    [[500, 0], 3],
  ] as [number[], number][]) {
    await assert.rejects(fox(kept, keeps), refused, `${kept} of ${keeps}`);
  }
  const tables = await fox([500, 140]);
  const [first, second] = [tables.group(0), tables.group(1)];
  const { keeps, ...alone } = second;
  await assert.rejects(tables.addGroup(1, packed(alone)), refused); // rows kept of nobody
  await assert.rejects(tables.addGroup(0, packed({ ...first, keeps: 1 })), refused); // of itself
  const late = await readTables(FOX);
  const entry = late.index.entry(1);
  late.index.entry = () => entry;
  const third = keeping(late.group(1), 2, [0, 0]);
  await late.addGroup(1, packed(second));
  await assert.rejects(late.addGroup(2, packed(third)), refused); // of a group that keeps rows itself
  await late.addGroup(3, packed({ ...third, keeps: 3 }));
  await assert.rejects(late.addGroup(2, packed(second)), refused); // which is known before its base
});

test("a base with fewer rows than are kept is refused, whichever is read first", async () => {
  const { base, keeper } = await fewer();
  const refused = {
    reason: "bad_value",
    message: /group\/3.json.gz.tiles\[0\].tiers\[1\].kept: expected 0 to 139, got 140/,
  };
  for (const order of [
    [base, keeper],
    [keeper, base],
  ]) {
    const tables = Tables.parse(readBytes(`${FOX}/airgs.json`));
    const entry = tables.index.entry(1);
    tables.index.entry = () => entry;
    const add = (table: Group) => tables.addGroup(table === base ? 1 : 2, packed(table));
    await add(order[0]!);
    await assert.rejects(add(order[1]!), refused);
  }
});

test("without the table of the base nothing of it can be said", async () => {
  const read = (path: string) => readBytes(`${FOX}/${path}`);
  const whole = await fox([500, 140]);
  const tables = Tables.parse(read("airgs.json"));
  await tables.addGroup(1, packed(whole.group(1)));
  assert.throws(() => tables.baseTable(1), /group\/1.json.gz has not been read/);
  assert.throws(() => tables.keptFiles(1, 0, 0), /group\/1.json.gz has not been read/);
  await tables.add(groupPath(1), read(groupPath(1)));
  assert.equal(tables.baseTable(1), tables.group(0));
});

// Values

/** Group 2 keeps all rows of tier 1, which move by other rows' depths, and none of tier 0. */
test("kept rows stand where the base has them", async () => {
  const tables = await fox([0, 3]);
  const [, count] = tables.group(1).tiles[0]!.tiers.map((tier) => tier.count);
  const own = readFox(tables, 1);
  const base = readFox(tables, 0);
  assert.equal(count, 140);
  assert.equal(own.depths.length, 563);
  assert.deepEqual([...own.depths.subarray(560)], [STATIC, 1, 0]);
  for (const [i, row] of [2, 7, 100].entries()) {
    assert.deepEqual(
      [...own.means.subarray(3 * (560 + i), 3 * (561 + i))],
      [...base.means.subarray(3 * (560 + row), 3 * (561 + row))],
    );
    assert.equal(own.units[560 + i], base.units[560 + row]);
  }
});

/** The positions of a group in Q1; tier 1 of group 2 has three kept rows alone. */
function readFox(tables: Tables, group: number): Positions {
  const table = tables.group(group);
  if (group) {
    const [first, last] = table.tiles[0]!.tiers;
    last!.count = last!.kept;
    table.tiles[0]!.tiers = [first!, last!];
  }
  const sidecar = columnFile([column(1, 2, 4, 92), column(1, 0, 2, 1)]);
  const read = (path: string) => (path === "key/T1/2.bin" ? sidecar : readBytes(`${FOX}/${path}`));
  return readPositions(tables, read, { group, tile: 0, quality: 1, tiers: 2 });
}

test("kept rows look as the table of the base says", () => {
  const root = { key_gain: 1, sh_degree: 0, qualities: [{ factor: 1 }] } as never;
  const steps = { log_scales: 1, quaternions: 1, opacity: 1, sh_dc: 1, sh_rest: 1 };
  const transform = (...numbers: number[]) => {
    const whole = Int16Array.from(numbers, (number) => 32767 * number);
    return Buffer.from(whole.buffer).toString("base64");
  };
  const group = { key_steps: steps, colour_transform: transform(1, 0, 0, 0, 1, 0, 0, 0, 1) } as Group;
  const base = {
    key_steps: { ...steps, log_scales: 1, opacity: 0.5, sh_dc: 5 },
    colour_transform: transform(0, 1, 0, 1, 0, 0, 0, 0, 1),
  } as Group;
  const own = partOf([[1, 0, 0, 0, 0, 0, 5, 1, 2, 3]], null);
  const other = partOf(
    [0, 1, 2].map((row) => [row, 0, 0, 0, 0, 0, row, 4, 5, row]),
    Uint32Array.of(0, 2),
    2,
  );
  const canonical: Canonical = {
    ...{ group: 1, tile: 0, quality: 0, tiers: 1 },
    means: new Float32Array(9),
    units: new Float32Array(3),
    depths: new Uint8Array(3),
    parts: [other, own],
  };
  const { logScales, alpha, colours } = canonicalGaussians(root, group, canonical, base);
  assert.deepEqual([...logScales.filter((_, i) => i % 3 === 0)], [0, 4, 1]);
  assert.deepEqual([...alpha], [0, 2, 5]);
  assert.deepEqual([...colours].map(Math.round), [50, 40, 0, 50, 40, 20, 1, 2, 3]);
});

/** A picture of codes by row and channel, one plane a channel below the other. */
function partOf(codes: number[][], kept: Uint32Array | null, factor = 1): KeyPart {
  const planes = codes[0]!.map((_, channel) => channel);
  const luma = new Uint8Array(256 * planes.length).fill(128);
  const place = [0, 1, 16]; // of the first three rows
  for (const [row, numbers] of codes.entries()) {
    for (const [plane, code] of numbers.entries()) luma[256 * plane + place[row]!]! += code;
  }
  const size = { plane_width: 16, columns: 1, width: 16, height: 16 * planes.length };
  const atlas = { rows: codes.length, centres: planes.map(() => 0), planes, max_error: [], ...size };
  return { atlas, factor, kept, luma, bases: null };
}

test("what a file of kept rows says is read to its end", () => {
  const file = columnFile([...KEPT, ...OTHERS]);
  assert.ok(file.length > 5);
  const reader = new ColumnReader(file, "file");
  for (const { order, numbers } of [...KEPT, ...OTHERS]) {
    assert.deepEqual([...reader.column(numbers.length, order)], numbers);
  }
  reader.close();
});

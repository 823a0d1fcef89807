import assert from "node:assert/strict";
import { test } from "node:test";
import { gzipSync } from "node:zlib";
import {
  atlasSamples,
  basesAfter,
  checkLuma,
  pages,
  planeCorner,
  planeHeight,
  readCodes,
  rowOffsets,
  slopeCodes,
} from "../../src/format/atlas.ts";
import { Bases, levelRows } from "../../src/format/files.ts";
import { canonicalGaussians, shownGaussians } from "../../src/format/gaussians.ts";
import { ColumnReader } from "../../src/format/rangecoder.ts";
import { motionUnits, readEscapes } from "../../src/format/sidecar.ts";
import type { Atlas, BaseChanges, Canonical, Gaussians, Group, Root } from "../../src/format/types.ts";
import { fromBase64, readVectors, runs } from "./files.ts";

interface Case {
  name: string;
  sh_degree: number;
  steps: Record<string, number>;
  factor: number;
  gain: number;
  colour_transform: string;
  grid?: Group["grid"];
}
type Values = Record<"means" | "quaternions" | "log_scales" | "alpha" | "colours", number[][]>;

/** As much of the tables as the values of a case depend on. */
function tables({ sh_degree, steps, factor, gain, colour_transform, grid }: Case): [Root, Group] {
  const ladder = { qualities: [{ factor }], levels: new Array(8).fill({ factor }) };
  const root = { sh_degree, keyframe_gain: gain, delta_gain: gain, ...ladder };
  const group = { keyframe_steps: steps, delta_steps: steps, colour_transform, grid };
  return [root as unknown as Root, group as unknown as Group];
}

/** The codes of a case, channels after one another. */
const codesOf = (codes: unknown[][]) => Int32Array.from(codes.flatMap(runs) as number[]);

/** Rows are near to what is expected, each as near as its tolerance says. */
function near(found: Gaussians, values: Partial<Values>, tolerance: Record<string, number[]>) {
  for (const [name, expected] of Object.entries(values)) {
    const got = name === "log_scales" ? found.logScales : found[name as keyof Gaussians];
    const rows = expected as (number | number[])[];
    assert.equal(got.length, rows.flat().length, name);
    rows.forEach((row, i) => {
      const width = got.length / rows.length;
      for (const [k, value] of [row].flat().entries()) {
        const off = Math.abs(got[i * width + k]! - value);
        const most = tolerance[name]![i]!;
        assert.ok(off <= most, `${name} of row ${i}: expected ${value}, got ${got[i * width + k]}, off by ${off}`);
      }
    });
  }
}

const planes = readVectors("planes");

test("rows stand in the places of their samples", () => {
  for (const { row, plane_width, place } of planes.places) {
    const atlas = { rows: row + 1, planes: [0], plane_width, columns: 1, width: 4096 } as unknown as Atlas;
    const at = rowOffsets(atlas)[row]!;
    assert.deepEqual([at % 4096, Math.floor(at / 4096)], place);
  }
});

for (const { name, luma, bases, codes, ...atlas } of planes.cases) {
  test(`planes: ${name}`, () => {
    const whole: Atlas = { ...atlas, max_error: [] };
    const picture = fromBase64(luma);
    assert.equal(picture.length, atlasSamples(whole));
    const all = new Int32Array(picture.length);
    (bases as unknown[][]).forEach((plane, p) => {
      const offsets = rowOffsets(whole);
      for (const [i, base] of (runs(plane) as number[]).entries()) all[planeCorner(whole, p) + offsets[i]!] = base;
    });
    assert.deepEqual([...readCodes(whole, picture, all)], [...codesOf(codes)]);
  });
}

test("luma that differs from its checksum is refused", () => {
  checkLuma(new Uint8Array(0), 0, "file");
  checkLuma(new TextEncoder().encode("123456789"), 0xcbf43926, "file"); // a value that is published
  const luma = new Uint8Array(100_000).map((_, i) => i % 251);
  const checksum = gzipChecksum(luma);
  checkLuma(luma, checksum, "file");
  luma[99_999]! ^= 1;
  for (const other of [checksum, undefined]) {
    assert.throws(() => checkLuma(luma, other, "file"), { reason: "bad_picture" });
  }
});

/** CRC-32 as gzip writes it before the length at its end. */
const gzipChecksum = (data: Uint8Array) => gzipSync(data).subarray(-8).readUInt32LE();

/** An atlas with a plane for each channel, and a picture in it that decodes to codes. */
function pictureOf(channels: unknown[][], centred = true): { atlas: Atlas; luma: Uint8Array; changes: BaseChanges } {
  const codes = channels.map((channel) => runs(channel) as number[]);
  const rows = codes[0]!.length;
  const planes = rows ? codes.map((_, channel) => channel) : [];
  const high = rows ? planeHeight(rows, 16) * codes.length : 0;
  const centres = codes.map((channel) => (centred && channel[0]) || 0);
  const atlas: Atlas = { rows, centres, planes, plane_width: 16, columns: 1, width: 16, height: high, max_error: [] };
  const luma = new Uint8Array(16 * high).fill(128);
  const offsets = rowOffsets(atlas);
  const places: number[] = [];
  const bases: number[] = [];
  for (const plane of planes) {
    codes[plane]!.forEach((code, i) => {
      const place = planeCorner(atlas, plane) + offsets[i]!;
      const base = Math.round((code - centres[plane]!) / 128);
      luma[place] = 128 + code - centres[plane]! - 128 * base;
      if (base) places.push(place);
      if (base) bases.push(base);
    });
  }
  return { atlas, luma, changes: { texels: Uint32Array.from(places), bases: Int32Array.from(bases) } };
}

for (const one of readVectors("keyframes").cases) {
  test(`keyframes: ${one.name}`, () => {
    const [root, group] = tables(one);
    const { atlas, luma, changes } = pictureOf(one.codes);
    const { rows } = atlas;
    const canonical: Canonical = {
      group: 0,
      quality: 0,
      tiers: 1,
      means: new Float32Array(3 * rows),
      units: new Float32Array(rows),
      depths: new Uint8Array(rows),
      parts: [{ atlas, factor: 1, luma, bases: changes, difference: null }],
    };
    near(canonicalGaussians(root, group, canonical), one.values, one.tolerance);
  });
}

/** Rows of numbers one after another. */
const flat = (rows: unknown[]) => Float32Array.from(rows.flat() as number[]);

for (const one of readVectors("deltas").cases) {
  const { means, quaternions, log_scales, alpha, colours, classes, depths } = one.canonical;
  const base: Gaussians = {
    means: flat(means),
    quaternions: flat(quaternions),
    logScales: flat(log_scales),
    alpha: flat(alpha),
    colours: flat(colours),
  };
  const canonical: Canonical = {
    group: 0,
    quality: 0,
    tiers: 1,
    means: base.means,
    units: motionUnits(Int16Array.from(runs(classes) as number[])),
    depths: Uint8Array.from(runs(depths) as number[]),
    parts: [],
  };
  test(`deltas: ${one.name}`, () => {
    const [root, group] = tables(one);
    assert.deepEqual([...levelRows(canonical.depths, one.level)], runs(one.rows));
    const rising = one.slopes && pictureOf(one.slopes, false);
    const slopes = rising ? slopeCodes(rising.luma, rising.changes) : null;
    for (const [t, { codes, values, tolerance }] of one.frames.entries()) {
      const { atlas, luma, changes } = pictureOf(codes);
      const table = { ...group, levels: new Array(8).fill(atlas) } as Group;
      const time = slopes ? (2 * t) / (one.frames.length - 1) - 1 : 0;
      const delta = { level: one.level, luma, bases: basesAfter(luma.length, [changes]), slopes, time };
      near(shownGaussians(root, table, base, canonical, delta), values, tolerance);
    }
  });
}

test("numbers that are not finite are refused", () => {
  const [root, group] = tables(readVectors("keyframes").cases[0]);
  group.keyframe_steps.log_scales = 1e38;
  const parts = [{ ...pictureOf(readVectors("keyframes").cases[0].codes), factor: 1, bases: null, difference: null }];
  const rows = parts[0]!.atlas.rows;
  const still = { units: new Float32Array(rows), depths: new Uint8Array(rows), means: new Float32Array(3 * rows) };
  const canonical = { group: 0, quality: 0, tiers: 1, ...still, parts };
  assert.throws(() => canonicalGaussians(root, group, canonical), { reason: "bad_value" });
});

test("bases of a picture change the codes of its samples, and those of the next", () => {
  const atlas = { rows: 2, centres: [5, 0], planes: [0], plane_width: 16, columns: 1, width: 16, height: 16 };
  const whole = { ...atlas, max_error: [] } as Atlas;
  assert.equal(pages(whole), 1);
  const one = readVectors("escapes").cases.find((each: { name: string }) => each.name === "the first sample");
  const bases = new Bases(readEscapes(new ColumnReader(fromBase64(one.data), "file"), 1, 1, 2), whole);
  const changes = bases.next(0)!;
  const [texels, now] = [[...changes.texels], [...changes.bases]];
  assert.deepEqual([texels, now], [[0], [1]]);
  assert.equal(bases.next(1), null);
});

import assert from "node:assert/strict";
import { test } from "node:test";
import { FormatError } from "../../src/format/errors.ts";
import { ColumnReader } from "../../src/format/rangecoder.ts";
import { canonicalMeans, mortonIndex, readDetail, readEscapes, readSidecar } from "../../src/format/sidecar.ts";
import { fromBase64, joined, readVectors, runs } from "./files.ts";

const refused = { name: "FormatError", reason: "bad_sidecar" };
const columns = readVectors("columns");
const positions = readVectors("positions");
const escapes = readVectors("escapes");

for (const { name, data, columns: expected } of columns.cases) {
  test(`columns: ${name}`, () => {
    const reader = new ColumnReader(fromBase64(data), "file");
    for (const { order, numbers } of expected) {
      const all = runs(numbers);
      const { lo, hi } = reader.wide(all.length, order);
      assert.deepEqual(
        [...lo].map((low, i) => joined(low, hi[i]!)),
        all.map(String),
      );
    }
    reader.close();
  });
}

for (const { name, data, columns: expected } of columns.refused) {
  test(`columns refused: ${name}`, () => {
    assert.throws(() => {
      const reader = new ColumnReader(fromBase64(data), "file");
      for (const { order, count } of expected) reader.wide(count, order);
      reader.close();
    }, refused);
  });
}

test("without data every number is 0", () => {
  const reader = new ColumnReader(null, "file");
  assert.deepEqual([...reader.column(3, 1)], [0, 0, 0]);
  reader.close();
});

test("a file is not asked for more numbers than it can hold", () => {
  assert.throws(() => new ColumnReader(fromBase64("APv/wAA="), "file").wide(2 ** 52, 0), refused);
});

test("a column of narrow numbers refuses wide ones", () => {
  const wide = columns.cases.find((one: { data: string; columns: { numbers: unknown[] }[] }) =>
    one.columns.some(({ numbers }) => runs(numbers).some((number) => BigInt(number as string) >= 2n ** 32n)),
  );
  assert.throws(() => {
    const reader = new ColumnReader(fromBase64(wide.data), "file");
    for (const { order, numbers } of wide.columns) reader.column(runs(numbers).length, order);
  }, refused);
});

test("morton codes", () => {
  for (const { index, code } of positions.morton) {
    const [lo, hi] = [Number(BigInt(code) & 0xffffffffn), Number(BigInt(code) >> 32n)];
    assert.deepEqual(
      [0, 1, 2].map((axis) => mortonIndex(lo, hi, axis)),
      index,
    );
  }
});

for (const { name, grid, rows, data, classes, depths, wider, qualities } of positions.tiers) {
  test(`tier: ${name}`, () => {
    const coarsest = qualities.at(-1).coarser;
    const shared = readSidecar(fromBase64(data), rows, rows, grid, coarsest, "file");
    assert.deepEqual([...shared.classes], runs(classes));
    assert.deepEqual([...shared.depths], runs(depths));
    assert.deepEqual([...shared.wider], runs(wider));
    for (const quality of qualities) {
      const reader = new ColumnReader(fromBase64(quality.data), "file");
      const tier = readDetail(reader, shared, grid, quality.coarser, coarsest);
      assert.equal(reader.column(1, 0)[0], 0);
      reader.close();
      assert.deepEqual(
        [...tier.codes.lo].map((low, i) => joined(low, tier.codes.hi[i]!)),
        runs(quality.codes),
      );
      assert.deepEqual([...canonicalMeans(tier, grid, quality.coarser)], quality.means.flat());
    }
  });
}

for (const { name, grid, rows, data, coarser, coarsest, detail } of positions.refused) {
  test(`tier refused: ${name}`, () => {
    assert.throws(() => {
      const shared = readSidecar(fromBase64(data), rows, rows, grid, coarsest, "file");
      const reader = new ColumnReader(detail === undefined ? null : fromBase64(detail), "file");
      readDetail(reader, shared, grid, coarser, coarsest);
      reader.column(1, 0);
      reader.close();
    }, refused);
  });
}

for (const { name, frames, planes, rows, data, bases } of escapes.cases) {
  test(`escapes: ${name}`, () => {
    const reader = new ColumnReader(fromBase64(data), "file");
    const { index, jumps } = readEscapes(reader, frames, planes, rows);
    reader.close();
    const now = new Int32Array(planes * rows);
    const found = Array.from({ length: frames }, (_, t) => {
      index.forEach((at, e) => {
        if (Math.floor(at / now.length) === t) now[at % now.length]! += jumps[e]!;
      });
      return [...now];
    });
    assert.deepEqual(
      found,
      bases.map((frame: number[][]) => frame.flatMap(runs)),
    );
  });
}

for (const { name, frames, planes, rows, data } of escapes.refused) {
  test(`escapes refused: ${name}`, () => {
    assert.throws(() => {
      const reader = new ColumnReader(fromBase64(data), "file");
      readEscapes(reader, frames, planes, rows);
      reader.close();
    }, refused);
  });
}

test("a refusal says what, where and why", () => {
  assert.throws(() => new ColumnReader(new Uint8Array(2), "keyframe/T0/1.bin"), {
    message: "keyframe/T0/1.bin: expected at least 5 bytes, got 2 (bad_sidecar)",
  });
  assert.ok(new FormatError("bad_value", "a", "b") instanceof Error);
});

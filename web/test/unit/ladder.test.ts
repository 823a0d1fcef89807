// Algorithm 1 of the paper: the cases it leaves undefined, which tests/play/ladder.json numbers.
import assert from "node:assert/strict";
import { test } from "node:test";
import { buildLadder, type Option, select, selectLiteral } from "../../src/play/ladder.ts";
import { readJson } from "./files.ts";

/** Levels 10 % apart, 100 bytes apart unless sizes are given. */
const dense = (qualities: number[], sizes = qualities.map((_, i) => 100 * (qualities.length - i))): Option[] =>
  qualities.map((quality, index) => ({ index, sizeBytes: sizes[index], quality, saved: 0.1 * index }));

const kept = (qualities: number[]) => buildLadder(dense(qualities)).map((p) => p.index);

type Numeral = number | "inf" | "nan";
interface Case {
  name: string;
  qualities: Numeral[];
}
interface Printed extends Case {
  sizes?: number[];
  budget?: Numeral;
  beta?: Numeral;
  answer: number | null;
}

const { ladders, printed } = readJson("tests/play/ladder.json") as {
  ladders: (Case & { kept: number[] })[];
  printed: Printed[];
};

const real = (numeral: Numeral) => (numeral === "inf" ? Infinity : Number(numeral));

for (const { name, qualities, kept: wanted } of ladders) {
  test(`ladder, ${name}`, () => assert.deepEqual(kept(qualities.map(real)), wanted));
}

test("9: sizes that do not fall", () => {
  const ladder = buildLadder(dense([40, 39, 38, 37], [1000, 400, 700, 300]));
  assert.deepEqual(
    ladder.map((p) => p.index),
    [0, 1, 3],
  );
  assert.equal(select(ladder, 500).index, 1);
});

test("7, 8: nothing fits, with a cliff and without one", () => {
  for (const qualities of [
    [40, 39, 38, 20],
    [40, 39, 38],
  ]) {
    const { index, fits } = select(buildLadder(dense(qualities)), 10);
    assert.deepEqual([index, fits], [2, false]);
  }
});

test("12: negative budgets count as 0", () => {
  for (const budget of [Number.NaN, -1, -Infinity, 0]) {
    const { index, fits } = select(buildLadder(dense([40, 39])), budget);
    assert.deepEqual([index, fits], [1, false]);
  }
});

test("14: a level that sends nothing always fits", () => {
  const ladder = buildLadder(dense([40, 39], [100, 0]));
  assert.deepEqual(select(ladder, -5), { index: 1, fits: true, sizeBytes: 0 });
});

for (const { name, qualities, sizes, budget = "inf", beta = 2, answer } of printed) {
  test(`as printed, ${name}`, () => {
    assert.equal(selectLiteral(dense(qualities.map(real), sizes), real(budget), real(beta)), answer);
  });
}

test("ladders fall strictly, and what they leave out is beaten", () => {
  for (let seed = 1; seed < 200; seed++) {
    const draw = (i: number, most: number) => Math.abs(Math.sin(seed * 12.9898 + i * 78.233) * 43758.5453) % most;
    const options = dense(
      Array.from({ length: 8 }, (_, i) => Math.round(draw(i, 12))),
      Array.from({ length: 8 }, (_, i) => Math.round(draw(i + 50, 9))),
    );
    const ladder = buildLadder(options, { beta: Infinity, cliffDb: Infinity });
    for (let i = 1; i < ladder.length; i++) {
      assert.ok(ladder[i - 1].sizeBytes > ladder[i].sizeBytes && ladder[i - 1].quality > ladder[i].quality);
    }
    for (const p of options) {
      assert.ok(ladder.some((r) => r.sizeBytes <= p.sizeBytes && r.quality >= p.quality));
    }
  }
});

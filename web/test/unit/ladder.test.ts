// Algorithm 1 of the paper: the cases it leaves undefined, as tests/play/test_ladder.py numbers them.
import assert from "node:assert/strict";
import { test } from "node:test";
import { buildLadder, type Option, select, selectLiteral } from "../../src/play/ladder.ts";

/** Levels 10 % apart, 100 bytes apart unless sizes are given. */
const dense = (qualities: number[], sizes = qualities.map((_, i) => 100 * (qualities.length - i))): Option[] =>
  qualities.map((quality, index) => ({ index, sizeBytes: sizes[index], quality, saved: 0.1 * index }));

const kept = (qualities: number[]) => buildLadder(dense(qualities)).map((p) => p.index);

const ladders: [string, number[], number[]][] = [
  ["1: the first drop is 0", kept([40, 40, 39.9, 36]), [1, 2]],
  ["2: a plateau, then a drop", kept([40, 39, 39, 38, 30]), [0, 2, 3]],
  ["3: a first drop of 0.001 dB is no yardstick", kept([40, 39.999, 39.9, 39.8]), [0, 1, 2, 3]],
  ["4: quality rises when pruning", kept([38, 40, 39, 38]), [1, 2, 3]],
  ["5: the mean of the earlier drops, not the last one", kept([40, 39, 37.2, 34, 28]), [0, 1, 2]],
  ["6: a cliff at the first level", kept([40, 36, 35]), [0]],
  ["6: no cliff there", kept([40, 38, 36]), [0, 1, 2]],
  ["10: one level", kept([40]), [0]],
  ["11: infinite quality counts as the cap", kept([Infinity, 99, 98]), [0, 1, 2]],
  ["16: level 0 has no privilege", kept([30, 35]), [1]],
];
for (const [name, levels, expected] of ladders) test(`ladder, ${name}`, () => assert.deepEqual(levels, expected));

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

const literal = (qualities: number[], budget = 1e9, more: { sizes?: number[]; beta?: number } = {}) =>
  selectLiteral(dense(qualities, more.sizes), budget, more.beta);

const answers: [string, number | null, number | null][] = [
  ["no cliff, everything fits", literal([40, 39, 38]), 0],
  ["no cliff, the second fits", literal([40, 39, 38], 250), 1],
  ["1: the first drop is 0: 0 / 0 and -0.1 / 0 are no cliffs", literal([40, 40, 39.9, 20], 150), 3],
  ["2: a plateau, then a drop: -9 / 0 is no cliff", literal([40, 39, 39, 30, 20], 10), null],
  ["3: a tiny first drop makes a cliff of 0.1 dB", literal([40, 39.999, 39.9, 39.8], 10), 2],
  ["4: rising quality changes the sign", literal([38, 40, 39, 30], 10), 3],
  ["5: a slow slide has no cliff", literal([34, 32, 30, 28, 26, 24, 14], 150), 6],
  ["6: the first level is never the cliff", literal([40, 20, 19], 250), 1],
  ["6: unless beta < 1", literal([40, 39, 38], 10, { beta: 0.5 }), 1],
  ["7: nothing fits, the answer is the cliff", literal([40, 39, 30, 20], 10), 2],
  ["8: nothing fits, no cliff: undefined", literal([40, 39, 38], 10), null],
  ["9: sizes that mislead the search", literal([40, 39, 38, 37, 36], 5, { sizes: [9, 4, 8, 7, 3] }), 4],
  ["10: one level", literal([40]), 0],
  ["10: one level that does not fit", literal([40], 10), null],
  ["11: infinite quality hides the first cliff", literal([Infinity, 30, 10, 5], 10), null],
  ["11: NaN passes silently", literal([40, Number.NaN, 20], 150), 2],
  ["12: a budget that is no number fits nothing", literal([40, 39], Number.NaN), null],
  ["14: a level of no bytes is one like any other", literal([40, 39], 0, { sizes: [100, 0] }), 1],
  ["16: level 0 is in S even if another is better", literal([30, 35]), 0],
];
for (const [name, answer, expected] of answers) test(`as printed, ${name}`, () => assert.equal(answer, expected));

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

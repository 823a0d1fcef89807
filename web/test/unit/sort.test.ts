// The depth order against a plain stable sort.
import assert from "node:assert/strict";
import { test } from "node:test";
import { DepthSorter, type DepthView, depthView } from "../../src/render/sort.ts";

const AHEAD: DepthView = { axis: [0, 0, 1, 0], near: 0.01 };

/** Numbers from -1 to 1 that are the same every time. */
function numbers(count: number, seed: number): Float32Array {
  let state = seed;
  return Float32Array.from({ length: count }, () => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return state / 2 ** 31 - 1;
  });
}

function depth(means: Float32Array, row: number, { axis }: DepthView): number {
  return axis[0] * means[3 * row] + axis[1] * means[3 * row + 1] + axis[2] * means[3 * row + 2] + axis[3];
}

/** Near to far with ties by row, as the CPU renderer has it; then backwards. */
function naive(means: Float32Array, view: DepthView): number[] {
  const rows = Array.from({ length: means.length / 3 }, (_, row) => row);
  const seen = rows.filter((row) => depth(means, row, view) > view.near && depth(means, row, view) < 1e10);
  seen.sort((a, b) => Math.fround(depth(means, a, view)) - Math.fround(depth(means, b, view)) || a - b);
  return seen.reverse();
}

function along(...depths: number[]): Float32Array {
  return Float32Array.from(depths.flatMap((z) => [0, 0, z]));
}

test("rows are in the order of a stable sort, whatever was sorted before", () => {
  const sorter = new DepthSorter();
  for (const [count, seed] of [
    [5000, 1],
    [300, 2],
    [20000, 3],
    [1, 4],
  ]) {
    const means = numbers(3 * count, seed);
    const view: DepthView = { axis: [0.36, -0.48, 0.8, 0.7], near: 0.2 };
    assert.deepEqual(Array.from(sorter.order(means, view)), naive(means, view));
  }
});

test("of equal depths the last row comes first", () => {
  const means = numbers(3 * 4000, 5).map((x) => Math.round(4 * x) / 4);
  const view: DepthView = { axis: [0, 0.5, 1, 2], near: 0.01 };
  const rows = new DepthSorter().order(means, view);
  assert.deepEqual(Array.from(rows), naive(means, view));
  assert.deepEqual(Array.from(new DepthSorter().order(along(2, 1, 2, 1), AHEAD)), [2, 0, 3, 1]);
});

test("depths that float32 cannot tell apart are equal", () => {
  const means = Float32Array.from([1, 1, 0, 1, 0, 0]);
  const view: DepthView = { axis: [1, 1e-9, 0, 0], near: 0.01 };
  assert.deepEqual(Array.from(new DepthSorter().order(means, view)), [1, 0]);
});

test("depths of all sizes are in order", () => {
  const means = along(1e-30, 3e9, 1, 65535, 65536, 1.0000001, 1e-5);
  assert.deepEqual(Array.from(new DepthSorter().order(means, { axis: [0, 0, 1, 0], near: 0 })), [1, 4, 3, 5, 2, 6, 0]);
});

test("what is not ahead, too near, too far or not a number is left out", () => {
  const means = along(-1, 0, 0.01, 0.011, Number.NaN, Number.POSITIVE_INFINITY, 1e19, 5);
  assert.deepEqual(Array.from(new DepthSorter().order(means, AHEAD)), [7, 3]);
  assert.deepEqual(Array.from(new DepthSorter().order(along(-1, -2), AHEAD)), []);
  assert.deepEqual(Array.from(new DepthSorter().order(new Float32Array(0), AHEAD)), []);
});

test("an order stays as it is when the next one is made", () => {
  const sorter = new DepthSorter();
  const first = sorter.order(along(1, 2, 3), AHEAD);
  sorter.order(along(3, 2, 1), AHEAD);
  assert.deepEqual(Array.from(first), [2, 1, 0]);
});

test("the depth of a camera is the third line of its matrix", () => {
  const worldToCamera = Float64Array.from({ length: 16 }, (_, i) => i);
  const camera = { width: 8, height: 8, fx: 8, fy: 8, cx: 4, cy: 4, near: 0.5, worldToCamera };
  assert.deepEqual(depthView(camera), { axis: [8, 9, 10, 11], near: 0.5 });
});

// The order of tiles in depth, from their boxes alone.
import assert from "node:assert/strict";
import { test } from "node:test";
import { type Box, farToNear } from "../../src/render/tile-order.ts";

const box = (low: number[], high: number[]): Box => ({ low, high });

test("of two boxes the one on the viewer's side of the plane between them is drawn last", () => {
  const boxes = [box([-2, -1, -1], [-1, 1, 1]), box([1, -1, -1], [2, 1, 1])];
  assert.deepEqual(farToNear(boxes, [5, 0, 0]), [0, 1]);
  assert.deepEqual(farToNear(boxes, [-5, 9, 9]), [1, 0]);
  assert.deepEqual(farToNear([...boxes].reverse(), [5, 0, 0]), [1, 0]);
});

test("boxes that overlap are divided where they overlap least", () => {
  const boxes = [box([0, 0, 0], [4, 4, 1.1]), box([0.5, 0, 0.9], [4, 3, 2])];
  assert.deepEqual(farToNear(boxes, [-9, 2, 0.5]), [1, 0]);
  assert.deepEqual(farToNear(boxes, [-9, 2, 1.5]), [0, 1]);
});

test("boxes that nothing tells apart stay in their order", () => {
  const one = box([0, 0, 0], [1, 1, 1]);
  assert.deepEqual(farToNear([one, one, one], [0.5, 0.5, 0.5]), [0, 1, 2]);
  assert.deepEqual(farToNear([], [0, 0, 0]), []);
});

/** Leaves of boxes that are halved at pseudo-random places. */
function halved(count: number, seed: number): Box[] {
  const boxes = [box([0, 0, 0], [1, 1, 1])];
  let state = seed;
  const random = () => {
    state = (1103515245 * state + 12345) % 2 ** 31;
    return state / 2 ** 31;
  };
  while (boxes.length < count) {
    const [half] = boxes.splice(Math.floor(random() * boxes.length), 1);
    const axis = Math.floor(random() * 3);
    const at = half!.low[axis]! + (half!.high[axis]! - half!.low[axis]!) * (0.2 + 0.6 * random());
    const [high, low] = [Array.from(half!.high), Array.from(half!.low)];
    high[axis] = low[axis] = at;
    boxes.push(box(Array.from(half!.low), high), box(low, Array.from(half!.high)));
  }
  return boxes;
}

/** Where a line from a point enters a box, of its length; null: it does not. */
function enters({ low, high }: Box, from: number[], to: number[]): number | null {
  let [first, last] = [0, 1];
  for (let axis = 0; axis < 3; axis++) {
    const along = to[axis]! - from[axis]!;
    const ends = [(low[axis]! - from[axis]!) / along, (high[axis]! - from[axis]!) / along].sort((a, b) => a - b);
    [first, last] = [Math.max(first, ends[0]!), Math.min(last, ends[1]!)];
  }
  return first < last - 1e-9 ? first : null;
}

test("no leaf of halvings is drawn before one that it hides", () => {
  for (let seed = 1; seed <= 20; seed++) {
    const boxes = halved(12, seed);
    const eye = [3 * Math.sin(seed), 2 * Math.cos(2 * seed), 3 * Math.cos(seed)];
    const order = farToNear(boxes, eye);
    assert.deepEqual(
      [...order].sort((a, b) => a - b),
      [...boxes.keys()],
    );
    for (let ray = 0; ray < 60; ray++) {
      const to = [0.5, 0.5, 0.5].map(
        (middle, axis) => middle + Math.sin(ray * (axis + 1.3)) - 3 * (eye[axis]! - middle),
      );
      const depths = order.map((place) => enters(boxes[place]!, eye, to)).filter((depth) => depth !== null);
      assert.deepEqual(
        depths,
        [...depths].sort((a, b) => b - a),
        `seed ${seed}, ray ${ray}`,
      );
    }
  }
});

test("boxes that hide each other in a circle have an order all the same", () => {
  const boxes = [box([0, 0, 0], [3, 1, 1]), box([2, 0.9, 0], [3, 3, 2]), box([0, 2.9, 0.9], [3, 4, 2])];
  assert.equal(new Set(farToNear(boxes, [1.4, 1.2, 9])).size, 3);
});

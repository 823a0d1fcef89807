// The order in which tiles are blended: from their boxes and from where the viewer stands. P boxes.

/** A part of space between two opposite corners, world units. */
export interface Box {
  readonly low: ArrayLike<number>;
  readonly high: ArrayLike<number>;
}

/** Which of two boxes may hide the other: a hides b (1), b hides a (−1), neither (0). Where one lies beyond the other
 * on an axis, it hides it from nobody who does not stand beyond its near side. Where they overlap on all axes, the
 * plane in the middle of the least overlap divides them.
 */
function hiding(a: Box, b: Box, eye: ArrayLike<number>): number {
  let [aHides, bHides] = [true, true];
  let widest = Number.NEGATIVE_INFINITY;
  let middle = 0;
  for (let axis = 0; axis < 3; axis++) {
    const up = a.low[axis] - b.high[axis] >= b.low[axis] - a.high[axis];
    const [lower, upper] = up ? [b.high[axis], a.low[axis]] : [a.high[axis], b.low[axis]];
    const [above, below] = [eye[axis] > upper, eye[axis] < lower];
    if (upper >= lower) [aHides, bHides] = [aHides && (up ? above : below), bHides && (up ? below : above)];
    if (upper - lower <= widest) continue;
    widest = upper - lower;
    middle = Math.sign(eye[axis] - (lower + upper) / 2) * (up ? 1 : -1);
  }
  return widest < 0 ? middle : Number(aHides) - Number(bHides);
}

/** Places of boxes far to near: no box comes before one that it hides. Boxes that were made by halving always have such
 * an order; where three or more hide each other in a circle, the one that hides fewest comes first.
 */
export function farToNear(boxes: readonly Box[], eye: ArrayLike<number>): number[] {
  /** (P) the boxes that each may hide. */
  const behind = boxes.map(() => new Set<number>());
  for (let a = 0; a < boxes.length; a++) {
    for (let b = a + 1; b < boxes.length; b++) {
      const nearer = hiding(boxes[a], boxes[b], eye);
      if (nearer > 0) behind[a].add(b);
      if (nearer < 0) behind[b].add(a);
    }
  }
  const left = new Set(boxes.keys());
  const order: number[] = [];
  while (left.size) {
    let next = -1;
    for (const box of left) if (next < 0 || behind[box].size < behind[next].size) next = box;
    left.delete(next);
    order.push(next);
    for (const others of behind) others.delete(next);
  }
  return order;
}

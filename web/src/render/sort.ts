// The order in which Gaussians are blended, and the worker that finds it, one request after the other; sorter.ts is its
// other end. N rows of a group, V of them in front of the viewer.
import type { Camera } from "../format/types.ts";
import { FAR } from "../generated/constants.ts";

/** What an order depends on besides the means: the plane in which depth is 0, and what is too near to be drawn. */
export interface DepthView {
  /** x, y, z and w: depth = x · mean x + y · mean y + z · mean z + w, world units. */
  axis: [number, number, number, number];
  near: number;
}

const DIGIT = 16;
const BUCKETS = 1 << DIGIT;

export function depthView(camera: Camera): DepthView {
  const m = camera.worldToCamera;
  return { axis: [m[8], m[9], m[10], m[11]], near: camera.near };
}

/** Sorts rows by depth, far to near; of equal depths the last row comes first. Depths are compared as float32, so that
 * this is the order of the CPU renderer, backwards. What is not in front of `near`, or not a number, is left out.
 *
 * It keeps its buffers from one sort to the next.
 */
export class DepthSorter {
  #keys = [new Uint32Array(0), new Uint32Array(0)];
  #rows = [new Uint32Array(0), new Uint32Array(0)];
  readonly #low = new Uint32Array(BUCKETS);
  readonly #high = new Uint32Array(BUCKETS);
  readonly #depth = new Float32Array(1);
  readonly #bits = new Uint32Array(this.#depth.buffer);

  /** (3N) means, world units -> (V) rows. */
  order(means: Float32Array, view: DepthView): Uint32Array<ArrayBuffer> {
    this.#grow(means.length / 3);
    const visible = this.#measure(means, view);
    const [keys, sorted] = this.#keys;
    const [rows, sortedRows] = this.#rows;
    firstPlaces(this.#low);
    firstPlaces(this.#high);
    for (let i = 0; i < visible; i++) {
      const at = this.#low[keys[i] & (BUCKETS - 1)]++;
      sorted[at] = keys[i];
      sortedRows[at] = rows[i];
    }
    const out = new Uint32Array(visible);
    for (let i = 0; i < visible; i++) out[this.#high[sorted[i] >>> DIGIT]++] = sortedRows[i];
    return out;
  }

  /** Keys of the visible rows, the last row first, and how often each digit occurs. Far rows have small keys. */
  #measure(means: Float32Array, { axis: [x, y, z, w], near }: DepthView): number {
    const [keys, rows, low, high] = [this.#keys[0], this.#rows[0], this.#low, this.#high];
    const [one, bits] = [this.#depth, this.#bits];
    low.fill(0);
    high.fill(0);
    let visible = 0;
    for (let row = means.length / 3 - 1; row >= 0; row--) {
      const depth = x * means[3 * row] + y * means[3 * row + 1] + z * means[3 * row + 2] + w;
      if (!(depth > near && depth < FAR)) continue; // so that no depth is infinite
      one[0] = depth;
      const key = ~bits[0] >>> 0; // positive floats are in the order of their bits
      keys[visible] = key;
      rows[visible++] = row;
      low[key & (BUCKETS - 1)]++;
      high[key >>> DIGIT]++;
    }
    return visible;
  }

  #grow(count: number): void {
    if (this.#keys[0].length >= count) return;
    this.#keys = [new Uint32Array(count), new Uint32Array(count)];
    this.#rows = [new Uint32Array(count), new Uint32Array(count)];
  }
}

function firstPlaces(counts: Uint32Array): void {
  let before = 0;
  for (let digit = 0; digit < BUCKETS; digit++) {
    const count = counts[digit];
    counts[digit] = before;
    before += count;
  }
}

export interface SortRequest {
  key: string;
  /** null: those that were given last for this key. */
  means: Float32Array | null;
  view: DepthView | null;
}

/** What comes of a request with a view: the rows, or null where no means were given for its key. */
export type SortAnswer = Uint32Array<ArrayBuffer> | null;

export function run(): void {
  const sorter = new DepthSorter();
  const known = new Map<string, Float32Array>();
  globalThis.onmessage = ({ data: { key, means, view } }: MessageEvent<SortRequest>) => {
    if (means) known.set(key, means);
    const last = known.get(key);
    const rows = last && view ? sorter.order(last, view) : null;
    if (view) postMessage(rows, { transfer: rows ? [rows.buffer] : [] });
    else known.delete(key);
  };
}

// The paper's level selection (arXiv 2512.20943, Algorithm 1), with its undefined cases defined.
//
// Numbers in comments are those of the undefined cases, which airgs_codec/play/ladder.py lists.
import { CLIFF_DB, DEFAULT_BETA, EPS_DB, PSNR_CAP } from "../generated/constants.ts";

/** One of the things that can be chosen: its size in bytes on the wire and the quality that it shows. */
export interface Option {
  index: number;
  sizeBytes: number;
  quality: number; // dB
  /** Share of the best level's bytes that its level saves, 0 … 1; 0 where nothing is known of that. */
  saved: number;
}

export interface Decision {
  index: number;
  fits: boolean;
  sizeBytes: number;
}

/** Options whose size and quality both fall strictly, from the best down to the last before the cliff.
 *
 * Pareto filter, then the cliff test. Drops are counted per 10 % of the bytes saved, over at least one such step from
 * level to level. A level is past the cliff when its drop exceeds `beta` times the mean of the earlier drops (at least
 * EPS_DB), or, for the first level, `cliffDb`. O(n log n).
 */
export function buildLadder(options: readonly Option[], { beta = DEFAULT_BETA, cliffDb = CLIFF_DB } = {}): Option[] {
  const front = pareto(options.map((option) => ({ ...option, quality: Math.min(option.quality, PSNR_CAP) })));
  const ladder = front.slice(0, 1);
  let steps = 0; // of 10 %, from the best level to the last of the ladder
  for (let i = 1; i < front.length; i++) {
    const [option, previous] = [front[i], front[i - 1]];
    const tenths = Math.max(1, 10 * (option.saved - previous.saved));
    const drop = (previous.quality - option.quality) / tenths;
    const mean = steps ? Math.max(EPS_DB, (front[0].quality - previous.quality) / steps) : null;
    if (mean === null ? drop > cliffDb : drop / mean > beta) break;
    ladder.push(option);
    steps += tenths;
  }
  return ladder;
}

/** Options that no other beats or equals at fewer bytes, best first (4, 9). */
function pareto(options: Option[]): Option[] {
  const front: Option[] = [];
  options.sort((a, b) => a.sizeBytes - b.sizeBytes || b.quality - a.quality || a.index - b.index);
  for (const option of options) {
    if (!front.length || option.quality > front[front.length - 1].quality) front.push(option);
  }
  return front.reverse();
}

/** The best level that fits, else the smallest with fits = false (7, 8). A negative budget is 0 (12). */
export function select(ladder: readonly Option[], budgetBytes: number): Decision {
  const chosen = ladder.find((option) => option.sizeBytes <= Math.max(0, budgetBytes));
  const { index, sizeBytes } = chosen ?? ladder[ladder.length - 1];
  return { index, fits: chosen !== undefined, sizeBytes };
}

/** Shares that levels save of the bytes of the first, the best; 0 where that has none or is no larger. */
export const savedShares = (sizes: ArrayLike<number>): number[] =>
  Array.from(sizes, (size) => (sizes[0] > 0 ? Math.max(0, 1 - size / sizes[0]) : 0));

/** Algorithm 1 as it is printed, over options in the order of their levels; null where it leaves p undefined.
 *
 * A step is q[i] − q[i−1], negative where quality falls. Divisions are IEEE: 0 / 0 is no number and never above beta,
 * and a fall after a step of 0 is −Infinity, so that the cliff is missed there. When nothing fits, the answer is the
 * cliff's level, whatever its size; see above for what `select` does.
 */
export function selectLiteral(options: readonly Option[], budgetBytes: number, beta = DEFAULT_BETA): number | null {
  let count = 1; // of levels before the cliff
  let previous = options.length > 1 ? options[1].quality - options[0].quality : 0;
  for (; count < options.length; count++) {
    const drop = options[count].quality - options[count - 1].quality;
    if (drop / (previous === 0 ? 0 : previous) > beta) break; // −0 counts as 0
    previous = drop;
  }
  let answer = count < options.length ? count : null;
  let [low, high] = [0, count - 1];
  while (low <= high) {
    const middle = (low + high) >> 1;
    if (options[middle].sizeBytes <= budgetBytes) {
      answer = middle;
      high = middle - 1;
    } else low = middle + 1;
  }
  return answer;
}

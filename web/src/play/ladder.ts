// The paper's level selection (arXiv 2512.20943, Algorithm 1), with its undefined cases defined.
//
// Where Algorithm 1 divides by zero, returns a level that does not fit or leaves its answer undefined, the comment
// names the case: first drop zero (1, 2), tiny (3), quality that rises when pruning (4), slow slides (5), the first
// level (6), nothing fits (7, 8), sizes that do not fall (9), one level or none (10), NaN and infinite quality (11),
// bad budgets (12), units (13: everything here is bytes), the level that sends nothing (14: not in a ladder), key units
// (15: chosen over the buffer, see the session), level 0 (16: no different from the others).
import { CLIFF_DB, DEFAULT_BETA, EPS_DB, PSNR_CAP } from "../generated/constants.ts";
import { ConfigError } from "./settings.ts";

/** One of the things that can be chosen: its size in bytes on the wire and the quality that it shows. */
export interface Option {
  /** In the caller's list, such as a level or a rung. */
  index: number;
  sizeBytes: number;
  /** dB */
  quality: number;
  /** Share of the best level's bytes that its level saves, 0 … 1; 0 where nothing is known of that. */
  saved: number;
}

/** The option that was chosen, and why. */
export interface Decision {
  /** Of the option. */
  index: number;
  /** Whether it is within the budget. */
  fits: boolean;
  /** In words, for people. */
  reason: string;
  sizeBytes: number;
}

/** What ends a ladder; see `buildLadder`. */
export interface Cliff {
  beta?: number;
  epsDb?: number;
  cliffDb?: number;
  minQuality?: number;
}

/** Options whose size and quality both fall strictly, from the best down to the last before the cliff.
 *
 * Pareto filter, then the cliff test. Drops are counted per 10 % of the bytes saved, over at least one such step from
 * level to level. A level is past the cliff when its drop exceeds `beta` times the mean of the earlier drops (at least
 * `epsDb`), or, for the first level, `cliffDb`; or when its quality is under `minQuality`. O(n log n). Throws
 * ConfigError: no options (10), beta ≤ 1 (6), a size or quality that is no number (11).
 */
export function buildLadder(options: readonly Option[], cliff: Cliff = {}): Option[] {
  const { beta = DEFAULT_BETA, epsDb = EPS_DB, cliffDb = CLIFF_DB, minQuality = -Infinity } = cliff;
  if (!(beta > 1)) throw new ConfigError(`cliff multiplier: expected more than 1, got ${beta}`);
  const front = pareto(options.map(checked));
  const ladder = front.slice(0, 1);
  let steps = 0; // of 10 %, from the best level to the last of the ladder
  for (let i = 1; i < front.length; i++) {
    const [option, previous] = [front[i], front[i - 1]];
    const tenths = Math.max(1, 10 * (option.saved - previous.saved));
    const drop = (previous.quality - option.quality) / tenths;
    const mean = steps ? Math.max(epsDb, (front[0].quality - previous.quality) / steps) : null;
    const past = mean === null ? drop > cliffDb : drop / mean > beta;
    if (past || option.quality < minQuality) break;
    ladder.push(option);
    steps += tenths;
  }
  return ladder;
}

function checked(option: Option): Option {
  if (Number.isNaN(option.quality) || !(option.sizeBytes >= 0)) {
    const got = `${option.sizeBytes} B and ${option.quality} dB`;
    throw new ConfigError(`level ${option.index}: expected a size and a quality, got ${got}`);
  }
  return { ...option, quality: Math.min(option.quality, PSNR_CAP) };
}

/** Options that no other beats or equals at fewer bytes, best first (4, 9). */
function pareto(options: Option[]): Option[] {
  if (!options.length) throw new ConfigError("ladder: expected at least one level, got none");
  const front: Option[] = [];
  options.sort((a, b) => a.sizeBytes - b.sizeBytes || b.quality - a.quality || a.index - b.index);
  for (const option of options) {
    if (!front.length || option.quality > front[front.length - 1].quality) front.push(option);
  }
  return front.reverse();
}

/** The best level that fits; when none does, the smallest with fits = false (7, 8).
 *
 * A budget that is negative or no number counts as 0 (12).
 */
export function select(ladder: readonly Option[], budgetBytes: number): Decision {
  const budget = positive(budgetBytes);
  const chosen = ladder.find((option) => option.sizeBytes <= budget);
  const { index, sizeBytes } = chosen ?? ladder[ladder.length - 1];
  const words = budget.toFixed(0);
  const reason = chosen ? `${sizeBytes} B fit ${words} B` : `nothing fits ${words} B, taking the smallest`;
  return { index, fits: chosen !== undefined, reason, sizeBytes };
}

/** Shares that levels save of the bytes of the first, the best; 0 where that has none or is no larger. */
export const savedShares = (sizes: ArrayLike<number>): number[] =>
  Array.from(sizes, (size) => (sizes[0] > 0 ? Math.max(0, 1 - size / sizes[0]) : 0));

/** Algorithm 1 as it is printed, over options in the order of their levels; null where it leaves p undefined.
 *
 * A step is q[i] − q[i−1], negative where quality falls. Divisions are IEEE: 0 / 0 is no number and never above beta,
 * and a fall after a step of 0 is −Infinity, so that the cliff is missed there. When nothing fits, the answer is the
 * cliff's level, whatever its size; see above for what `select` does. Throws ConfigError without options.
 */
export function selectLiteral(options: readonly Option[], budgetBytes: number, beta = DEFAULT_BETA): number | null {
  if (!options.length) throw new ConfigError("Algorithm 1: expected at least one level, got none");
  let count = 1; // of levels before the cliff
  let previous = options.length > 1 ? options[1].quality - options[0].quality : 0;
  for (; count < options.length; count++) {
    const drop = options[count].quality - options[count - 1].quality;
    if (ratio(drop, previous) > beta) break;
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

/** a / b, with the sign of a alone where b is 0 or −0. */
const ratio = (a: number, b: number): number => a / (b === 0 ? 0 : b);

/** Bytes a frame may have: the paper's C = B / R with its units, `share` of it spent, less what a request costs.
 *
 * A bandwidth that is negative or no number counts as 0 (12). Throws ConfigError unless fps > 0.
 */
export function frameBudget(bandwidthBps: number, fps: number, overheadBytes = 0, share = 1): number {
  if (!(fps > 0)) throw new ConfigError(`frame rate: expected more than 0, got ${fps}`);
  return Math.max(0, (share * positive(bandwidthBps)) / (8 * fps) - overheadBytes);
}

/** A number; 0 for one that is negative or none. */
const positive = (value: number): number => (Number.isNaN(value) ? 0 : Math.max(0, value));

// Algorithm 1 of the paper (arXiv 2512.20943) with its cases defined, and as printed; each with and without the cliff.
import { DEFAULT_BETA } from "../../generated/constants.ts";
import { type Decision, frameBudget, select, selectLiteral } from "../ladder.ts";
import { beforeCliff, budgetBytes, estimateThroughput, fullLadder, type PlayerState, segmentS } from "./state.ts";

/** Algorithm 1 over the measured sizes and qualities of this very segment. */
export const choosePaper = (state: PlayerState): Decision => choosePaperNoCliff(beforeCliff(state));

/** The search of Algorithm 1 alone: the best rung that fits. */
export const choosePaperNoCliff = (state: PlayerState): Decision => select(fullLadder(state), budgetBytes(state));

/** Algorithm 1 as printed: C = B / R over the segment, no buffer, round trip or safety; undefined: the last level.
 *
 * Its levels are the rungs with the finest keys, whole group keys in the sizes.
 */
export function choosePaperLiteral(state: PlayerState, beta = DEFAULT_BETA): Decision {
  const count = state.catalogue.tables.root.levels.length;
  const finest = state.options.filter((option) => option.index < count);
  const levels = finest.length ? finest : state.options;
  const budget = frameBudget(estimateThroughput(state.history), 1 / segmentS(state));
  const answer = selectLiteral(levels, budget, beta);
  const { index, sizeBytes } = levels[answer ?? levels.length - 1];
  const reason = answer === null ? "Algorithm 1 leaves it undefined" : `Algorithm 1 for ${budget.toFixed(0)} B`;
  return { index, fits: sizeBytes <= budget, reason, sizeBytes };
}

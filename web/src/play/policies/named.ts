// The policies by name: Algorithm 1 of the paper (arXiv 2512.20943) with its cases defined, and as printed; rules of
// the throughput and of the buffer; one rung for ever; and the controller of mpc.ts.
import { DEFAULT_BETA, type DEFAULT_POLICY, type POLICY_NAMES, RESERVE_S, SAFETY } from "../../generated/constants.ts";
import { type Decision, select, selectLiteral } from "../ladder.ts";
import type { PlayerState, Policy } from "./state.ts";
import { beforeCliff, budgetBytes, bufferS, estimateThroughput, fullLadder, limitS, segmentS } from "./state.ts";

/** Algorithm 1 over the measured sizes and qualities of this very segment. */
const choosePaper = (state: PlayerState): Decision => choosePaperNoCliff(beforeCliff(state));

/** The search of Algorithm 1 alone: the best rung that fits. */
const choosePaperNoCliff = (state: PlayerState): Decision => select(fullLadder(state), budgetBytes(state));

/** Algorithm 1 as printed: C = B / R over the segment, no buffer, round trip or safety; undefined: the last level.
 *
 * Its levels are the rungs with the finest keyframes, whole group keyframes in the sizes.
 */
function choosePaperLiteral(state: PlayerState, beta = DEFAULT_BETA): Decision {
  const { rungs } = state.ahead[0].offer;
  const finest = state.options.filter(({ index }) => rungs[index].quality === 0);
  const levels = finest.length ? finest : state.options;
  const budget = estimateThroughput(state.history) / (8 / segmentS(state));
  const answer = selectLiteral(levels, budget, beta);
  const { index, sizeBytes } = levels[answer ?? levels.length - 1];
  return { index, fits: sizeBytes <= budget, sizeBytes };
}

/** The best rung within SAFETY · B over the segment's own length. */
const chooseThroughput = (state: PlayerState): Decision =>
  select(fullLadder(state), (SAFETY * estimateThroughput(state.history) * segmentS(state)) / 8);

/** BOLA-BASIC, Lyapunov optimisation of the buffer (Spiteri et al., INFOCOM 2016): the rung with the largest (V (u + g)
 * − Q) / size, whose utilities come from measured quality.
 *
 * u is quality in nepers above the smallest rung, Q the buffer in seconds. V and g are such that the smallest rung is
 * left at RESERVE_S (a third of a smaller buffer) and the best one scores nothing when the buffer is full.
 */
function chooseBola(state: PlayerState): Decision {
  const rungs = fullLadder(state);
  const last = rungs[rungs.length - 1];
  if (rungs.length === 1) return { index: last.index, fits: true, sizeBytes: last.sizeBytes };
  const utility = rungs.map((rung) => ((rung.quality - last.quality) * Math.log(10)) / 20);
  const limit = Math.max(limitS(state) - segmentS(state), segmentS(state));
  const reserve = Math.min(RESERVE_S, limit / 3);
  const better = rungs.slice(0, -1);
  const bend = Math.max(...better.map((p, i) => (utility[i] * last.sizeBytes) / (p.sizeBytes - last.sizeBytes)));
  const v = (limit - reserve) / (utility[0] + bend);
  const g = bend + reserve / v;
  const scores = rungs.map((p, i) => (v * (utility[i] + g) - bufferS(state)) / Math.max(1, p.sizeBytes));
  const most = Math.max(...scores);
  const { index, sizeBytes } = rungs[most <= 0 ? 0 : scores.indexOf(most)];
  return { index, fits: true, sizeBytes };
}

type Name = Exclude<(typeof POLICY_NAMES)[number], typeof DEFAULT_POLICY>;

const CHOOSE: Record<Name, Policy["choose"]> = {
  paper: choosePaper,
  "paper-no-cliff": choosePaperNoCliff,
  "paper-literal": (state) => choosePaperLiteral(state),
  "paper-literal-no-cliff": (state) => choosePaperLiteral(state, Infinity),
  throughput: chooseThroughput,
  bola: chooseBola,
};

export const OTHERS: ReadonlyMap<string, Policy> = new Map(
  Object.entries(CHOOSE).map(([name, choose]) => [name, { name, choose, adapts: true, horizon: 1 }]),
);

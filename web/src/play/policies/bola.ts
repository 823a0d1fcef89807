// BOLA-BASIC: Lyapunov optimisation of the buffer (Spiteri et al., INFOCOM 2016).
//
// Utilities come from measured quality, sizes are those of each segment.
import { RESERVE_S } from "../../generated/constants.ts";
import type { Decision } from "../ladder.ts";
import { bufferS, fullLadder, limitS, type PlayerState, segmentS } from "./state.ts";

/** The rung with the largest (V (u + g) − Q) / size.
 *
 * u is quality in nepers above the smallest rung, Q the buffer in seconds. V and g are such that the smallest rung is
 * left at RESERVE_S (a third of a smaller buffer) and the best one scores nothing when the buffer is full.
 */
export function chooseBola(state: PlayerState): Decision {
  const rungs = fullLadder(state);
  const last = rungs[rungs.length - 1];
  if (rungs.length === 1) return { index: last.index, fits: true, reason: "one rung", sizeBytes: last.sizeBytes };
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
  return { index, fits: true, reason: `buffer ${bufferS(state).toFixed(2)} s`, sizeBytes };
}

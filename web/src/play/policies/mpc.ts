// Model-predictive control with a discounted throughput estimate (Yin et al., SIGCOMM 2015).
//
// It knows the true sizes and qualities of what comes (as Puffer, NSDI 2020). R rungs, P rungs of the segment before
// (or 1, where they do not matter), B points of the buffer's grid. Values are in dB times seconds; the coefficients
// were chosen on the Ghent 4G traces, none of which is in the studies of the documentation.
import {
  GRID_POINTS,
  HORIZON_S,
  HORIZON_SEGMENTS,
  LOW_BUFFER_DB,
  PAST_DOWNLOADS,
  POLICY_NAMES,
  RESERVE_S,
  STALL_DB,
  SWITCH_DB,
} from "../../generated/constants.ts";
import { type Decision, select } from "../ladder.ts";
import { ConfigError, type Keyframes, NONE, type Offers, type SegmentOffer, sizesOf } from "../offers.ts";
import {
  bufferS,
  type Download,
  fullLadder,
  limitS,
  type PlayerState,
  type Policy,
  segmentS,
  shownS,
} from "./state.ts";

/** bit/s: harmonic mean of the last downloads over 1 + the worst relative error of predicting them so. */
export function discountedThroughput(history: readonly Download[]): number {
  const rates = history.slice(-2 * PAST_DOWNLOADS).map((d) => (8 * d.bytes) / d.seconds);
  if (!rates.length) return 0;
  let worst = 0;
  for (let i = Math.max(1, rates.length - PAST_DOWNLOADS); i < rates.length; i++) {
    const predicted = harmonic(rates.slice(Math.max(0, i - PAST_DOWNLOADS), i));
    worst = Math.max(worst, predicted / rates[i] - 1);
  }
  return harmonic(rates.slice(-PAST_DOWNLOADS)) / (1 + worst);
}

const harmonic = (rates: readonly number[]): number => rates.length / rates.reduce((sum, rate) => sum + 1 / rate, 0);

/** The link and the buffer as the controller takes them to be. */
interface Model {
  rateBps: number;
  latencyS: number;
  limitS: number;
  /** (B) buffers for which values are known. */
  gridS: Float64Array;
}

interface Step {
  seconds: number;
  /** (P · R) bytes of rung r after rung p of the segment before, at place p R + r. */
  sizes: Float64Array;
  quality: Float64Array; // (R) dB
}

/** The first of the rungs that maximise quality − changes − stalls − want of a reserve over the next segments.
 *
 * Dynamic programming backwards over (rung before, buffer), the buffer on a grid, at a constant discounted rate.
 */
export function chooseRobustMpc(state: PlayerState): Decision {
  const rateBps = discountedThroughput(state.history);
  if (rateBps <= 0) return select(fullLadder(state), 0);
  const model = { rateBps, latencyS: state.requestLatencyS, limitS: limitS(state), gridS: grid(limitS(state)) };
  const steps = horizon(state);
  /** (R · B) best total of what follows the first step, by its rung and the buffer that it leaves. */
  let value: Float64Array = new Float64Array(steps[0].quality.length * GRID_POINTS);
  for (let i = steps.length - 1; i > 0; i--) value = valueBefore(model, steps[i], steps[i - 1].quality, value);
  const [have, seconds] = [bufferS(state), segmentS(state)];
  let best = { total: -Infinity, fits: false, option: state.options[0] };
  for (const option of state.options) {
    const took = downloadS(model, option.sizeBytes);
    const change = state.shownQuality === null ? 0 : Math.abs(option.quality - state.shownQuality);
    const stall = Math.max(took - have, 0);
    const left = Math.min(Math.max(have - took, 0) + seconds, model.limitS);
    const low = LOW_BUFFER_DB * Math.max(RESERVE_S - left, 0);
    const after = interpolate(left, model.gridS, value, option.index * GRID_POINTS);
    const total = seconds * (option.quality - SWITCH_DB * change - low) - STALL_DB * stall + after;
    const smaller = total === best.total && option.sizeBytes < best.option.sizeBytes;
    if (total > best.total || smaller) best = { total, fits: stall <= 0, option };
  }
  const { index, sizeBytes } = best.option;
  return { index, fits: best.fits, sizeBytes };
}

/** Seconds to fetch so many bytes; nothing is requested for none. */
const downloadS = (model: Pick<Model, "latencyS" | "rateBps">, bytes: number): number =>
  (bytes > 0 ? model.latencyS : 0) + (8 * bytes) / model.rateBps;

function horizon(state: PlayerState): Step[] {
  const steps: Step[] = [];
  let total = 0;
  for (const [i, { offer, loop }] of state.ahead.entries()) {
    if (steps.length && total >= HORIZON_S) break;
    const known = loop === state.ahead[0].loop ? state.decoded : NONE; // in a later loop, keyframes are fetched again
    const sizes = i ? sizesAfter(offer, state.ahead[i - 1].offer, known) : new Float64Array(0); // the options have them
    const seconds = shownS(state, offer);
    steps.push({ seconds, sizes, quality: Float64Array.from(offer.rungs, ({ psnr }) => psnr) });
    total += seconds;
  }
  return steps;
}

/** (P · R) bytes of rung r after rung p of the segment before, at place p R + r; (R) where that makes no difference.
 *
 * `known` are keyframe tiers that are decoded by then; of the group that goes on, rung p alone says what is.
 */
export function sizesAfter(offer: SegmentOffer, before: SegmentOffer, known: Keyframes): Float64Array {
  if (offer.startsGroup && offer.base === null) return sizesOf(offer, NONE);
  const others = offer.startsGroup ? known : NONE;
  const table = new Float64Array(before.rungs.length * offer.rungs.length);
  for (const [p, { keyframes }] of before.rungs.entries()) {
    const held = new Set(keyframes.map(({ number }) => number));
    table.set(sizesOf(offer, { has: (number) => others.has(number) || held.has(number) }), p * offer.rungs.length);
  }
  return table;
}

/** (R · B) best total from a step on, by the rung before it and the buffer; `value` is that of what follows it. */
function valueBefore(model: Model, step: Step, qualityBefore: Float64Array, value: Float64Array): Float64Array {
  const rungs = step.quality.length;
  const alike = step.sizes.length === rungs; // the rung before makes no difference to sizes; else to few of them
  const best = new Float64Array(value.length).fill(-Infinity);
  const total = new Float64Array(GRID_POINTS);
  for (let r = 0; r < rungs; r++) {
    let size = -1;
    for (let p = 0; p < rungs; p++) {
      const wanted = step.sizes[alike ? r : p * rungs + r];
      if (wanted !== size) totals(model, step, { r, size: wanted }, value, total);
      size = wanted;
      const change = step.seconds * SWITCH_DB * Math.abs(step.quality[r] - qualityBefore[p]);
      for (let b = 0, at = p * GRID_POINTS; b < GRID_POINTS; b++, at++) {
        if (total[b] - change > best[at]) best[at] = total[b] - change;
      }
    }
  }
  return best;
}

/** Into `total`: (B) what a rung r of so many bytes brings, with what follows, changes of quality aside. */
function totals(
  { gridS, limitS, latencyS, rateBps }: Model,
  { seconds, quality }: Step,
  { r, size }: { r: number; size: number },
  value: Float64Array,
  total: Float64Array,
): void {
  const took = downloadS({ latencyS, rateBps }, size);
  const row = r * GRID_POINTS;
  const scale = (GRID_POINTS - 1) / limitS;
  for (let b = 0; b < GRID_POINTS; b++) {
    const buffer = gridS[b] - took;
    const left = Math.min(Math.max(buffer, 0) + seconds, limitS);
    const at = Math.min(Math.trunc(left * scale), GRID_POINTS - 2);
    const part = left * scale - at;
    const here = seconds * quality[r] + STALL_DB * Math.min(buffer, 0);
    const low = seconds * LOW_BUFFER_DB * Math.max(RESERVE_S - left, 0);
    total[b] = here - low + value[row + at] * (1 - part) + value[row + at + 1] * part;
  }
}

function grid(stop: number): Float64Array {
  const step = stop / (GRID_POINTS - 1);
  return Float64Array.from({ length: GRID_POINTS }, (_, i) => (i === GRID_POINTS - 1 ? stop : i * step));
}

/** The value at a place of the grid, linear between its points; `row` is where the values of the grid begin. */
function interpolate(place: number, gridS: Float64Array, value: Float64Array, row: number): number {
  if (place >= gridS[GRID_POINTS - 1]) return value[row + GRID_POINTS - 1];
  let at = 0;
  while (at < GRID_POINTS - 2 && gridS[at + 1] <= place) at++;
  const slope = (value[row + at + 1] - value[row + at]) / (gridS[at + 1] - gridS[at]);
  return slope * (place - gridS[at]) + value[row + at];
}

export const ROBUST_MPC: Policy = {
  name: "robust-mpc",
  choose: chooseRobustMpc,
  adapts: true,
  horizon: HORIZON_SEGMENTS,
};

/** Name of the policy that plays what is wished for; "auto" is the best rung of a still, and of what was not measured. */
export function wishedPolicy(wishes: { quality: string; policy: string }, { measured, live, tables }: Offers): string {
  if (wishes.quality !== "auto") return `fixed:${wishes.quality}`;
  return measured && (live || tables.root.frames > 1) ? wishes.policy : "fixed:0";
}

/** fixed:J (level J, finest keyframes) or fixed:RUNG, in the finest level offered. Throws ConfigError for other names. */
export function fixedPolicy(name: string, offers: Offers): Policy {
  const rung = fixedRung(name, offers);
  const choose: Policy["choose"] = ({ options }) => {
    const smallest = options.reduce((a, b) => (b.sizeBytes < a.sizeBytes ? b : a));
    const wanted = rung + Math.max(0, offers.finest - offers.rungs[rung][1]);
    const { index, sizeBytes } = options.find((option) => option.index === wanted) ?? smallest;
    return { index, fits: true, sizeBytes };
  };
  return { name, choose, adapts: false, horizon: 1 };
}

function fixedRung(name: string, { names, tables }: Offers): number {
  const levels = tables.root.levels.length;
  const wanted = name.startsWith("fixed:") ? name.slice("fixed:".length) : "";
  if (names.includes(wanted)) return names.indexOf(wanted);
  if (/^[0-9]+$/.test(wanted) && Number(wanted) < levels) return Number(wanted);
  const expected = `${POLICY_NAMES.join(", ")}, fixed:0 … fixed:${levels - 1} or fixed:${names.at(-1)}`;
  throw new ConfigError(`policy: expected ${expected}, got ${name}`);
}

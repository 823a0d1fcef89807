// What a policy is, what it knows, and the estimates that several policies share.
import { BUFFER_SHARE, HALF_LIVES_S, SAFETY } from "../../generated/constants.ts";
import { buildLadder, type Decision, type Option } from "../ladder.ts";
import type { Keyframes, SegmentOffer } from "../offers.ts";

/** A finished batch, as the throughput estimate sees it. */
export interface Download {
  bytes: number;
  /** From the first byte to the last. */
  seconds: number;
}

/** What is known when a segment is to be requested. Times are seconds of the downloader's clock. */
export interface PlayerState {
  /** What the next segments offer, with their loops over the sequence: as many as the policy looks at, one at least. */
  ahead: readonly { offer: SegmentOffer; loop: number }[];
  /** Keyframe tiers that are decoded in the loop of the next segment. */
  decoded: Keyframes;
  options: readonly Option[];
  nowS: number;
  /** When it must arrive to be shown in time; in the past when the player waits. */
  deadlineS: number;
  /** Most media time ahead of the playhead. */
  bufferLimitS: number;
  requestLatencyS: number;
  /** dB of the segment before it; null: none, or it was lost. */
  shownQuality: number | null;
  history: readonly Download[]; // oldest first
  /** Seconds of media that a second shows. */
  speed: number;
}

/** A rule that chooses the rung of the next segment, and what the player may do beside it. */
export interface Policy {
  name: string;
  choose: (state: PlayerState) => Decision;
  /** By measured quality, with downloads given up that would come too late, and better rungs for buffered segments. */
  adapts: boolean;
  /** Segments whose sizes it looks at, the next one first. */
  horizon: number;
}

export const shownS = (state: PlayerState, offer: SegmentOffer): number => offer.seconds / state.speed;

/** Seconds for which the segment to be requested is on the screen. */
export const segmentS = (state: PlayerState): number => shownS(state, state.ahead[0].offer);

/** Seconds until what is at hand has been shown. */
export const bufferS = (state: PlayerState): number => Math.max(0, state.deadlineS - state.nowS);

/** Seconds that a full buffer shows. */
export const limitS = (state: PlayerState): number => state.bufferLimitS / state.speed;

/** bit/s: the smaller of two exponential averages weighted by download time; 0 before the first download. */
export function estimateThroughput(history: readonly Download[]): number {
  return Math.min(
    ...HALF_LIVES_S.map((halfLife) => {
      let [value, weight] = [0, 0];
      for (const { bytes, seconds } of history) {
        const keep = 0.5 ** (seconds / halfLife);
        value = keep * value + ((1 - keep) * 8 * bytes) / seconds;
        weight = keep * weight + (1 - keep);
      }
      return weight > 0 ? value / weight : 0;
    }),
  );
}

/** Bytes that can arrive in time: the paper's B / R over a segment, plus half of the time that is buffered.
 *
 * SAFETY · B · window / 8, window = max(segment, BUFFER_SHARE · (deadline − now)) − latency. Sizes include headers.
 */
export function budgetBytes(state: PlayerState): number {
  const buffered = BUFFER_SHARE * (state.deadlineS - state.nowS);
  const window = Math.max(segmentS(state), buffered) - state.requestLatencyS;
  return (SAFETY * estimateThroughput(state.history) * window) / 8;
}

/** The rungs worth having, without the cliff test. */
export const fullLadder = (state: PlayerState): Option[] =>
  buildLadder(state.options, { beta: Infinity, cliffDb: Infinity });

/** The same with those rungs alone whose level is not past the cliff of its segment; with all, if there are none. */
export function beforeCliff(state: PlayerState): PlayerState {
  const { rungs } = state.ahead[0].offer;
  const finest = rungs.filter(({ quality }) => quality === 0);
  const levels = finest.map(({ level, deltaBytes, psnr, saved }) => {
    return { index: level, sizeBytes: deltaBytes, quality: psnr, saved };
  });
  const least = buildLadder(levels).at(-1)?.sizeBytes ?? 0;
  const options = state.options.filter(({ index }) => rungs[index].deltaBytes >= least);
  return options.length ? { ...state, options } : state;
}

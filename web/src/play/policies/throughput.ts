// What the throughput estimate sustains, whatever is buffered.
import { SAFETY } from "../../generated/constants.ts";
import { type Decision, select } from "../ladder.ts";
import { estimateThroughput, fullLadder, type PlayerState, segmentS } from "./state.ts";

/** The best rung within SAFETY · B over the segment's own length. */
export const chooseThroughput = (state: PlayerState): Decision =>
  select(fullLadder(state), (SAFETY * estimateThroughput(state.history) * segmentS(state)) / 8);

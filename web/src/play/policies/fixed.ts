// Always the same rung, as a reference and for people who choose.
import type { Decision } from "../ladder.ts";
import type { PlayerState } from "./state.ts";

/** One rung for every segment; the smallest one where it cannot be had. */
export function chooseFixed(state: PlayerState, rung: number): Decision {
  const smallest = state.options.reduce((a, b) => (b.sizeBytes < a.sizeBytes ? b : a));
  const { index, sizeBytes } = state.options.find((option) => option.index === rung) ?? smallest;
  return { index, fits: true, reason: "fixed", sizeBytes };
}

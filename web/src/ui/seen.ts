// What was on the screen, in which rung: a player may forget it.
import type { Part } from "./player-like.ts";

/** A longer way between two pictures is a jump: nothing was seen in between. */
const JUMP_S = 1;

/** What was seen, in order of time seen, with a picture at `time` in a rung: it takes the place of what was there. */
export function seen(parts: readonly Part[], time: number, rung: number): Part[] {
  const last = parts.at(-1);
  const goesOn = last && last.rung === rung && time >= last.stop && time - last.stop < JUMP_S;
  const grown = { start: goesOn ? last.start : time, stop: time, rung };
  const others = (goesOn ? parts.slice(0, -1) : parts).flatMap((part) => {
    if (part.start > grown.stop || part.stop <= grown.start) return [part];
    const rest = [
      { ...part, stop: Math.min(part.stop, grown.start) },
      { ...part, start: Math.max(part.start, grown.stop) },
    ];
    return rest.filter((one) => one.stop > one.start);
  });
  return [...others, grown];
}

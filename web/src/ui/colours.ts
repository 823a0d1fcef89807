// Colours of rungs: from dark to light as they get better, so that those who see no hues tell them apart as well.
import type { RungInfo } from "../play/rungs.ts";

/** Viridis (Smith and van der Walt 2015) without its darkest part, which the dark time line would swallow. */
const RAMP = [
  [62, 84, 150],
  [42, 120, 142],
  [34, 168, 132],
  [122, 209, 81],
  [253, 231, 37],
] as const;

/** The colour of a share, 0: the worst … 1: the best. */
export function rampColour(share: number): string {
  const place = Math.max(0, Math.min(1, share)) * (RAMP.length - 1);
  const first = Math.min(Math.floor(place), RAMP.length - 2);
  const mixed = RAMP[first].map((low, i) => Math.round(low + (place - first) * (RAMP[first + 1][i] - low)));
  return `rgb(${mixed.join(" ")})`;
}

/** Numbers of rungs from the worst to the best: by what they claim, where nobody knows by what they cost. */
export function ranked(rungs: readonly RungInfo[]): number[] {
  const worth = (rung: number) => rungs[rung].psnr ?? 0;
  return rungs.map((_, i) => i).sort((a, b) => worth(a) - worth(b) || rungs[a].kbps - rungs[b].kbps);
}

/** A colour for each rung, by their rank. */
export function rungColours(rungs: readonly RungInfo[]): string[] {
  const colours: string[] = [];
  ranked(rungs).forEach((rung, rank) => {
    colours[rung] = rampColour(rungs.length > 1 ? rank / (rungs.length - 1) : 1);
  });
  return colours;
}

/** A CSS picture of coloured parts of a line of some length, from left to right; nothing between them. */
export function stripes(parts: readonly { start: number; stop: number; colour: string }[], total: number): string {
  if (!(total > 0) || parts.length === 0) return "none";
  const at = (seconds: number) => `${((100 * seconds) / total).toFixed(3)}%`;
  const stops: string[] = [];
  let end = 0;
  for (const { start, stop, colour } of parts) {
    if (start > end) stops.push(`#0000 ${at(end)} ${at(start)}`);
    stops.push(`${colour} ${at(Math.max(start, end))} ${at(stop)}`);
    end = Math.max(end, stop);
  }
  if (end < total) stops.push(`#0000 ${at(end)}`);
  return `linear-gradient(to right, ${stops.join(", ")})`;
}

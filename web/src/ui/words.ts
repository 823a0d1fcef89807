// Figures in words and colours.
import type { POLICY_NAMES } from "../generated/constants.ts";
import type { RungInfo } from "../play/rungs.ts";
import type { Desk } from "./desk.ts";

const MINUTE = 60;
const HOUR = 3600;

/** So short sequences are told in tenths of a second. */
const SHORT_S = 20;

/** 83 s as "1:23"; with hours where `total` has them, and with tenths where that is short. */
export function clock(seconds: number, total = seconds): string {
  if (total > 0 && total < SHORT_S) return `${Math.max(0, seconds).toFixed(1)} s`;
  const whole = Math.max(0, Math.floor(Number.isFinite(seconds) ? seconds : 0));
  const two = (n: number) => String(n).padStart(2, "0");
  const minutes = Math.floor(whole / MINUTE);
  if (!(Math.max(whole, total) >= HOUR)) return `${minutes}:${two(whole % MINUTE)}`;
  return `${Math.floor(whole / HOUR)}:${two(minutes % MINUTE)}:${two(whole % MINUTE)}`;
}

/** The same for those who listen: "1 minute 23 seconds". */
export function spoken(seconds: number): string {
  const whole = Math.max(0, Math.floor(seconds));
  const parts = [
    [Math.floor(whole / HOUR), "hour"],
    [Math.floor(whole / MINUTE) % MINUTE, "minute"],
    [whole % MINUTE, "second"],
  ] as const;
  const said = parts.filter(([n]) => n > 0).map(([n, unit]) => `${n} ${unit}${n === 1 ? "" : "s"}`);
  return said.join(" ") || "0 seconds";
}

/** Three digits, in thousands of a unit or more: 0.52 kB, 5.2, 52, 520. */
function short(value: number, unit: string): string {
  const power = value >= 1e9 ? 3 : value >= 1e6 ? 2 : 1;
  const shown = value / 1000 ** power;
  return `${shown.toFixed(shown >= 9.95 ? 0 : shown < 0.995 ? 2 : 1)} ${" kMG"[power]}${unit}`;
}

export const rate = (bps: number): string => (bps > 0 ? short(bps, "bit/s") : "–");
export const size = (bytes: number): string => short(bytes, "B");
export const decibels = (psnr: number | null): string => (psnr === null ? "–" : `${psnr.toFixed(1)} dB`);

/** What a rung costs: bytes of a still, else a rate; "": not known yet. */
export function cost({ player, still }: Desk, { kbps }: RungInfo): string {
  if (!(kbps > 0)) return "";
  return still ? size(125 * kbps * player.duration) : rate(1000 * kbps);
}

/** Names a rung by its place among those that are worth their bytes; another one by what it costs. */
export function rungTitle(desk: Desk, rung: RungInfo): string {
  const { rungs } = desk;
  const order = ranked(rungs).filter((one) => rungs[one].onLadder);
  const [place, best] = [order.indexOf(rungs.indexOf(rung)), order.length - 1];
  if (place < 0) return cost(desk, rung) || rung.name;
  if (place === 0 || place === best) return place ? "Best" : best ? "Smallest" : "Best";
  return 2 * place > best ? "Good" : "Small";
}

/** The figures of a rung that its title does not have. */
export const rungFigures = (desk: Desk, rung: RungInfo): string =>
  [rung.onLadder ? cost(desk, rung) : "", rung.psnr === null ? "" : decibels(rung.psnr)].filter(Boolean).join(" · ");

export const speedName = (speed: number): string => (speed === 1 ? "Normal" : `${speed}×`);

/** The rung that is chosen; undefined: "Auto". */
export const chosenRung = ({ rungs, player }: Desk): RungInfo | undefined =>
  rungs.find(({ name }) => name === player.quality);

/** The quality that is chosen, for buttons. */
export function qualityName(desk: Desk): string {
  const rung = chosenRung(desk);
  return rung ? rungTitle(desk, rung) : "Auto";
}

export const POLICIES: ReadonlyMap<string, string> = new Map<(typeof POLICY_NAMES)[number], string>([
  ["paper", "As in the paper"],
  ["paper-no-cliff", "As in the paper, no cliff"],
  ["paper-literal", "The paper to the letter"],
  ["paper-literal-no-cliff", "To the letter, no cliff"],
  ["throughput", "By throughput"],
  ["bola", "By buffer (BOLA)"],
  ["robust-mpc", "By prediction (robust MPC)"],
]);

export const SOURCES: Readonly<Record<string, string>> = {
  cameras: "about its cameras",
  found: "found by looking",
  orbit: "an orbit, guessed",
  file: "as given",
};

/** Viridis (Smith and van der Walt 2015) without its darkest part, which the dark time line would swallow. */
const RAMP = [
  [62, 84, 150],
  [42, 120, 142],
  [34, 168, 132],
  [122, 209, 81],
  [253, 231, 37],
] as const;

export function rampColour(share: number): string {
  const place = Math.max(0, Math.min(1, share)) * (RAMP.length - 1);
  const first = Math.min(Math.floor(place), RAMP.length - 2);
  const mixed = RAMP[first].map((low, i) => Math.round(low + (place - first) * (RAMP[first + 1][i] - low)));
  return `rgb(${mixed.join(" ")})`;
}

/** Numbers of rungs from the worst to the best: by what they claim, else by what they cost, else the first is best. */
export function ranked(rungs: readonly RungInfo[]): number[] {
  const worth = (rung: number) => rungs[rung].psnr ?? 0;
  return rungs.map((_, i) => i).sort((a, b) => worth(a) - worth(b) || rungs[a].kbps - rungs[b].kbps || b - a);
}

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

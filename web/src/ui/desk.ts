// What the parts of the element know of it, and what it asks of a player.
import type { PlayerOptions } from "../play/playback.ts";
import type { Player } from "../play/player.ts";
import type { RungInfo } from "../play/rungs.ts";
import { readAddress, writeAddress } from "./address.ts";
import type { Orbit } from "./orbit.ts";

/** `Player`, or one that only pretends, in tests. */
export type PlayerLike = Omit<Player, "canvas" | "on" | "seeking" | "world">;

export type PlayerSettings = Pick<PlayerOptions, "policy" | "loop" | "budget" | "muted" | "volume">;

/** A part of the time line, in seconds, and the number of its rung. */
export type Part = Player["buffered"][number];

export const EVENTS = [
  ...["open", "poster", "firstpicture", "rung", "stall", "resume", "time", "progress", "ended", "vr", "volumechange"],
  ...["pause", "play", "problem", "lost", "restored"],
];

/** The view as its parts know it. */
export interface Desk {
  readonly player: PlayerLike;
  readonly orbit: Orbit;
  /** Ends with this life of the element. */
  readonly signal: AbortSignal;
  /** The rungs of the package, as they were known a moment ago, and the colour of each. */
  readonly rungs: readonly RungInfo[];
  readonly colours: readonly string[];
  readonly ready: boolean;
  readonly full: boolean;
  /** Whether the package has one frame. */
  readonly still: boolean;
  /** Whether two rungs are beside each other, and whether there are two. */
  readonly split: boolean;
  readonly comparable: boolean;
  /** Whether there is a headset to put on. */
  readonly headset: boolean;
  /** The share of the display's pixels in each direction that is drawn, and how many these are. */
  readonly scale: number;
  readonly picture: readonly [number, number];
  toggle(): void;
  seek(seconds: number): void;
  skip(seconds: number): void;
  frame(count: number): void;
  /** Back to where the viewer began; `first`: to the first place of the region, to begin there again. */
  home(first?: boolean): void;
  beginHere(): void;
  turnOver(): void;
  /** Go to where all of the subject is seen. */
  showSubject(): void;
  toggleSplit(): void;
  toggleKeys(): void;
  /** Whether the address of the page says where to begin, and copies of it can. */
  readonly linked: boolean;
  copyLink(): void;
  toggleFull(): void;
  toggleVr(): void;
  toggleInfo(): void;
  toggleSound(): void;
  /** Changes an attribute of the element, and with it the player. */
  set(attribute: "loop" | "quality" | "policy" | "view-region", value: string | boolean): void;
  /** Something has changed: look at everything in the next animation frame. */
  wake(): void;
}

export function momentOf({ player, orbit }: Desk): string {
  const { currentTime: t, quality, speed } = player;
  const [rung, other] = [quality === "auto" ? {} : { rung: quality }, speed === 1 ? {} : { speed }];
  return writeAddress({ t, view: orbit.stance, ...rung, ...other });
}

/** Go to a moment that is told as text; a line for each part of it that cannot be done. */
export function goTo(desk: Desk, text: string): string[] {
  const { player, orbit, rungs } = desk;
  const { moment, wrong } = readAddress(text);
  const { t, view, rung, speed } = moment;
  if (t !== undefined && t > player.duration) wrong.push(`t=${t}: expected at most ${player.duration.toFixed(3)} s`);
  else if (t !== undefined) player.seek(t);
  const names = ["auto", ...rungs.map(({ name }) => name)];
  if (rung && !names.includes(rung)) wrong.push(`rung=${rung}: expected one of ${names.join(", ")}`);
  else if (rung) desk.set("quality", rung);
  if (speed) player.speed = speed;
  if (view) {
    orbit.begin(view);
    if (orbit.outside && !orbit.free) desk.set("view-region", "free");
  }
  return wrong;
}

/** Copies a link to the moment that is shown, or makes it the address of the page; says which. */
export async function copyLink(desk: Desk): Promise<string> {
  const link = `#${momentOf(desk)}`;
  try {
    await navigator.clipboard.writeText(location.href.replace(/#.*|$/, link));
    return "Copied: a link to this view.";
  } catch {
    history.replaceState(null, "", link);
    return "The address of the page is now a link to this view.";
  }
}

// What the parts of the element know of it, and what it asks of a player.
import type { PlayerOptions } from "../play/playback.ts";
import type { Player } from "../play/player.ts";
import type { RungInfo } from "../play/rungs.ts";
import type { Orbit } from "./orbit.ts";

/** `Player`, or one that only pretends, in tests. */
export type PlayerLike = EventTarget &
  Pick<Player, "open" | "play" | "pause" | "seek" | "close" | "paused" | "ended" | "live" | "loop" | "speed"> &
  Pick<Player, "currentTime" | "duration" | "fps" | "buffered" | "rungs" | "rung" | "quality" | "policy"> &
  Pick<Player, "region" | "camera" | "stats" | "resize">;

export type PlayerSettings = Pick<PlayerOptions, "policy" | "loop" | "budget" | "viewAdaptive">;

/** A part of the time line, in seconds, and the number of its rung. */
export type Part = Player["buffered"][number];

/** What a player tells. */
export const EVENTS = [
  "open",
  "firstpicture",
  "rung",
  "stall",
  "resume",
  "time",
  "progress",
  "ended",
  "pause",
  "play",
  "problem",
  "lost",
  "restored",
] as const;

/** Everything that a viewer can do, from wherever. */
export interface Desk {
  readonly player: PlayerLike;
  readonly orbit: Orbit;
  /** Ends with this life of the element. */
  readonly signal: AbortSignal;
  /** The rungs of the package, as they were known a moment ago, and the colour of each. */
  readonly rungs: readonly RungInfo[];
  readonly colours: readonly string[];
  /** There is a package to play. */
  readonly ready: boolean;
  readonly full: boolean;
  /** The share of the display's pixels in each direction that is drawn, and how many these are. */
  readonly scale: number;
  readonly picture: readonly [number, number];
  toggle(): void;
  seek(seconds: number): void;
  skip(seconds: number): void;
  frame(count: number): void;
  home(): void;
  toggleFull(): void;
  toggleInfo(): void;
  /** Attributes of the element change with these. */
  setLoop(loop: boolean): void;
  setQuality(quality: string): void;
  setPolicy(policy: string): void;
  setFree(free: boolean): void;
  /** Something has changed: look at everything in the next animation frame. */
  wake(): void;
}

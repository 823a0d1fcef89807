// What the element asks of a player: `Player` of play/player.ts, or one that only pretends, in tests.
import type { Region } from "../format/types.ts";
import type { RungInfo } from "../play/rungs.ts";
import type { PlayerStats } from "../play/statistics.ts";
import type { ViewState } from "../play/view.ts";

/** A part of the time line, in seconds, and the number of its rung. */
export interface Part {
  readonly start: number;
  readonly stop: number;
  readonly rung: number;
}

export interface PlayerLike extends EventTarget {
  open(src: string): Promise<void>;
  play(): void | Promise<void>;
  pause(): void;
  seek(seconds: number): void | Promise<void>;
  close(): void;
  readonly paused: boolean;
  readonly ended: boolean;
  readonly live: boolean;
  loop: boolean;
  speed: number;
  readonly currentTime: number;
  /** Seconds; 0 before a package is open. */
  readonly duration: number;
  /** Frames a second; what one step forth or back is made of. */
  readonly fps: number;
  readonly buffered: readonly Part[];
  readonly rungs: readonly RungInfo[];
  /** The number of the rung on the screen. */
  readonly rung: number | null;
  /** "auto", or the name of a rung. */
  quality: string;
  policy: string;
  readonly region: Region | null;
  camera: ViewState;
  readonly stats: PlayerStats;
  /** Pixels of the pictures, for the next one that is drawn. */
  resize(width: number, height: number): void;
}

export interface PlayerSettings {
  policy?: string;
  loop?: boolean;
  /** Most Gaussians that are fetched and shown of a group. */
  budget?: number;
  /** Fetch only the tiles that are expected in sight, where a package has several. */
  viewAdaptive?: boolean;
}

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

// A segment of the timeline of a playout.
import type { Offers } from "./offers.ts";

/** Moments (`…S`) are seconds of the downloader's clock, places (`…At`) those of the schedule. */
export interface Slot {
  readonly position: number;
  /** Null: lost. */
  rung: number | null;
  /** The rung of each tile that is there. */
  readonly tiles: Map<number, number>;
  /** Of media. */
  readonly seconds: number;
  readonly frames: number;
  /** When it has arrived and is decoded. */
  readonly readyS: number;
  readonly readyAt: number;
  /** Of its display; Infinity while it waits. */
  startAt: number;
  /** Seconds waited for it on the screen. */
  stallS: number;
  /** Its decoding began: what it shows can no longer change. */
  committed: boolean;
}

/** A segment that waits. */
export function newSlot(offers: Offers, place: Pick<Slot, "position" | "rung" | "tiles" | "readyS" | "readyAt">): Slot {
  const { start, stop } = offers.span(place.position);
  const frames = stop - start;
  return { ...place, seconds: frames / offers.fps, frames, startAt: Infinity, stallS: 0, committed: false };
}

/** The last that is wanted. */
export function lastSlot(slots: readonly Slot[], wanted: (slot: Slot) => boolean): Slot | null {
  for (let i = slots.length - 1; i >= 0; i--) if (wanted(slots[i])) return slots[i];
  return null;
}

// Which buffered segment a better rung would serve best: what a player does when nothing more fits its buffer.
import { REPLACE_GAIN_DB } from "../generated/constants.ts";
import type { Batch, Catalogue } from "./catalogue.ts";
import { filesOf } from "./catalogue.ts";
import type { Option } from "./ladder.ts";
import type { Playout } from "./playout.ts";
import type { Slot } from "./slot.ts";
import type { Stores } from "./stores.ts";

/** A better rung of a buffered segment. */
export interface Replacement {
  /** dB seconds a byte. */
  worth: number;
  slot: Slot;
  option: Option;
}

/** The link as a replacement is expected to find it. */
export interface Outlook {
  nowS: number;
  rttS: number;
  rateBps: number;
}

interface Deadline extends Outlook {
  startS: number;
  decodeS: number;
}

/** The replacement that gains most for its bytes among those expected in time; null: none. */
export function bestReplacement(c: Catalogue, playout: Playout, stores: Stores, link: Outlook): Replacement | null {
  const decodeS = playout.settings.decodeFrameS;
  let best: Replacement | null = null;
  for (const slot of playout.pending()) {
    const startS = playout.startS(slot, link.nowS);
    if (!(link.nowS < startS && startS < Infinity)) continue;
    for (const option of stores.keys.options(slot.position, tilesOf(slot))) {
      const worth = worthOf(c, slot, option, { ...link, startS, decodeS });
      if (worth === null || (best && worth <= best.worth)) continue;
      if (usable(stores, replacing(c, stores, slot, option.index))) best = { worth, slot, option };
    }
  }
  return best;
}

function worthOf(c: Catalogue, slot: Slot, option: Option, link: Deadline): number | null {
  const gain = option.quality - (slotQuality(c, slot) ?? 0);
  const [index, level] = [c.index(slot.position), c.rungs[slot.rung ?? 0][1]];
  // The state is decoded where only the keys would be better.
  const states = c.ofTiles(tilesOf(slot)).stateBytes(index);
  const size = option.sizeBytes - (c.rungs[option.index][1] === level ? states[level] : 0);
  const arrivalS = link.nowS + link.rttS + (8 * size) / link.rateBps;
  if (gain < REPLACE_GAIN_DB || arrivalS + link.decodeS > link.startS) return null;
  return (gain * slot.seconds) / Math.max(1, size);
}

/** What it takes to show another rung of a buffered segment: with the same level, only its keys. */
export function replacing(c: Catalogue, stores: Stores, slot: Slot, rung: number): Batch {
  const batch = stores.keys.missing(slot.position, rung, tilesOf(slot));
  return c.rungs[rung][1] === c.rungs[slot.rung ?? 0][1] ? { ...batch, state: [] } : batch;
}

/** The tiles of a segment, ascending. */
const tilesOf = (slot: Slot): number[] => [...slot.tiles.keys()].sort((a, b) => a - b);

/** Whether no file of a batch was found missing or corrupt. */
export const usable = (stores: Stores, batch: Batch): boolean =>
  !stores.unusable.size || filesOf(batch).every((path) => !stores.unusable.has(path));

/** Those of the tiles of a position that can be had in some rung; all if none can, so that the segment is lost. */
export function obtainable(stores: Stores, position: number, tiles: readonly number[]): readonly number[] {
  const found = tiles.filter((tile) =>
    stores.keys
      .options(position, [tile])
      .some(({ index }) => usable(stores, stores.keys.missing(position, index, [tile]))),
  );
  return stores.unusable.size && found.length ? found : tiles;
}

/** dB, null of a lost segment. */
export const slotQuality = (c: Catalogue, slot: Slot): number | null =>
  slot.rung === null ? null : c.quality(c.index(slot.position))[slot.rung];

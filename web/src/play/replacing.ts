// Which buffered segment a better rung would serve best: what a player does when nothing more fits its buffer.
import { REPLACE_GAIN_DB } from "../generated/constants.ts";
import type { Option } from "./ladder.ts";
import { type Batch, filesOf, type Offers } from "./offers.ts";
import type { Playout, Slot } from "./playout.ts";
import type { Stores } from "./stores.ts";

interface Replacement {
  /** dB seconds a byte. */
  worth: number;
  slot: Slot;
  option: Option;
}

/** The replacement that gains most for its bytes among those expected in time; null: none. */
export function bestReplacement(
  o: Offers,
  playout: Playout,
  stores: Stores,
  link: { nowS: number; rttS: number; rateBps: number },
): Replacement | null {
  let best: Replacement | null = null;
  for (const slot of playout.pending()) {
    const startS = playout.startS(slot, link.nowS);
    if (!(link.nowS < startS && startS < Infinity)) continue;
    const { decodeFrameS } = playout.settings;
    const comes = (bytes: number) => link.nowS + link.rttS + (8 * bytes) / link.rateBps + decodeFrameS <= startS;
    for (const option of stores.keys.options(slot.position, tilesOf(slot))) {
      const worth = worthOf(o, slot, option, comes);
      if (worth === null || (best && worth <= best.worth)) continue;
      if (usable(stores, replacing(o, stores, slot, option.index))) best = { worth, slot, option };
    }
  }
  return best;
}

/** dB seconds a byte; null: it gains little, or would not come in time. */
function worthOf(o: Offers, slot: Slot, option: Option, comes: (bytes: number) => boolean): number | null {
  const gain = option.quality - (slotQuality(o, slot) ?? 0);
  const { level, stateBytes } = o.of(o.index(slot.position), tilesOf(slot)).rungs[option.index];
  // The state is decoded where only the keys would be better.
  const size = option.sizeBytes - (level === o.rungs[slot.rung ?? 0][1] ? stateBytes : 0);
  if (gain < REPLACE_GAIN_DB || !comes(size)) return null;
  return (gain * slot.seconds) / Math.max(1, size);
}

/** The files that it takes to show another rung of a buffered segment: with the same level, only its keys. */
export function replacing(o: Offers, stores: Stores, slot: Slot, rung: number): Batch {
  const batch = stores.keys.missing(slot.position, rung, tilesOf(slot));
  return o.rungs[rung][1] === o.rungs[slot.rung ?? 0][1] ? { ...batch, state: [] } : batch;
}

const tilesOf = (slot: Slot): number[] => [...slot.tiles.keys()].sort((a, b) => a - b);

/** Whether no file of a batch was found missing or corrupt. */
export const usable = (stores: Stores, batch: Batch): boolean =>
  !stores.unusable.size || filesOf(batch).every((path) => !stores.unusable.has(path));

/** Those of the tiles of a position that can be had in some rung; all if none can, so that the segment is lost. */
export function obtainable(stores: Stores, position: number, tiles: readonly number[]): readonly number[] {
  if (!stores.unusable.size) return tiles;
  const { keys } = stores;
  const found = tiles.filter((tile) =>
    keys.options(position, [tile]).some(({ index }) => usable(stores, keys.missing(position, index, [tile]))),
  );
  return found.length ? found : tiles;
}

/** dB, null of a lost segment. */
export const slotQuality = (o: Offers, slot: Slot): number | null =>
  slot.rung === null ? null : o.of(o.index(slot.position)).rungs[slot.rung].psnr;

// Which tiles are fetched by a player that knows how its viewer moves: airgs_codec/play/tile_choice.py.
//
// Early, when a segment is asked for, those that the picture is expected to show while the segment is shown. Nobody can
// tell more than a second ahead how a viewer turns, so that tiles will be lacking; what a wider picture is expected to
// show soon before it is shown is fetched then. Measured in docs/results/tiles.md.
import type { Camera } from "../format/types.ts";
import { BEFORE_S, EARLY_MARGIN, FURTHEST_S, LATE_MARGIN, SOON_S } from "../generated/constants.ts";
import type { Catalogue } from "./catalogue.ts";
import { Kept } from "./kept.ts";
import type { Playout } from "./playout.ts";
import { Boxes, expected, velocityOf, type Watcher } from "./sight.ts";
import type { Slot } from "./slot.ts";

const KEPT_GROUPS = 64;

/** A tile that a segment lacks. */
export interface Lack {
  slot: Slot;
  tile: number;
}

/** Chooses tiles for sessions over one package. Moments are seconds of the downloader's clock. */
export class TileChoice {
  readonly #boxes = new Kept<Boxes>(KEPT_GROUPS);

  constructor(
    private readonly catalogue: Catalogue,
    private readonly playout: Playout,
    private readonly watcher: Pick<Watcher, "at">,
  ) {}

  /** The tiles to fetch with the next segment, ascending: never none, and all that have rows while nobody looks. */
  early(position: number, nowS: number): number[] {
    const startS = this.playout.startsAtS(this.playout.dueAt(nowS), nowS);
    const off = this.#off(position, nowS, startS, startS + this.catalogue.secondsAt(position) / this.playout.speed);
    const most = Math.max(EARLY_MARGIN, Math.min(...off));
    const inSight = this.catalogue.tiles.filter((tile) => off[tile] <= most && off[tile] < Infinity);
    return inSight.length ? inSight : this.catalogue.tilesWithRows(this.catalogue.index(position));
  }

  /** What is to be fetched late, the first segment first, then what is nearest to the middle of the picture. */
  lacking(nowS: number): Lack[] {
    const found: Lack[] = [];
    for (const slot of this.playout.unfinished(nowS)) {
      const startS = this.playout.startS(slot, nowS);
      if (startS > nowS + SOON_S) break;
      const off = this.#off(slot.position, nowS, startS, this.playout.endS(slot, nowS));
      const tiles = this.catalogue.tiles.filter((tile) => off[tile] <= LATE_MARGIN && !slot.tiles.has(tile));
      tiles.sort((a, b) => off[a] - off[b]);
      found.push(...tiles.map((tile) => ({ slot, tile })));
    }
    return found;
  }

  /** (P) degrees that each tile is beside the pictures expected of a span of time; Infinity for one without rows. */
  #off(position: number, nowS: number, startS: number, stopS: number): number[] {
    const { group } = this.catalogue.group(position);
    const boxes = this.#boxes.get(group, () => new Boxes(this.catalogue.tables.boxes(group)));
    const views = this.#expected(nowS, startS, stopS).map((view) => boxes.degreesOff(view));
    const off = this.catalogue.tiles.map(() => Infinity);
    for (const tile of this.catalogue.tilesWithRows(this.catalogue.index(position))) {
      off[tile] = Math.min(...views.map((degrees) => degrees[tile]));
    }
    return off;
  }

  /** The pictures expected at the start, in the middle and at the end of a span, as far as can be told. */
  #expected(nowS: number, startS: number, stopS: number): Camera[] {
    const [here, before] = [this.watcher.at(nowS), this.watcher.at(nowS - BEFORE_S)];
    if (!here || !before) return [];
    const velocity = velocityOf(before, here);
    const [first, last] = [Math.max(nowS, startS), Math.max(nowS, stopS)];
    const moments = [first, (first + last) / 2, last].map((atS) => Math.min(atS - nowS, FURTHEST_S));
    return [...new Set(moments)].map((aheadS) => expected(here, velocity, aheadS));
  }
}

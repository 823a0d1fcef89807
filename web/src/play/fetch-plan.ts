// The fetch plan of a segment says which tiles a player fetches when: all of them, or by view, where a player knows how
// its viewer moves.
//
// By view, those come early, when a segment is asked for, that the picture is expected to show while the segment is
// shown. Nobody can tell more than a second ahead how a viewer turns, so that tiles will be lacking; what a wider
// picture is expected to show soon before it is shown is fetched then. Measured in docs/results/tiles.md.
import { Recent } from "../format/recent.ts";
import type { Camera } from "../format/types.ts";
import { BEFORE_S, EARLY_MARGIN, FURTHEST_S, LATE_MARGIN, SOON_S } from "../generated/constants.ts";
import type { Offers } from "./offers.ts";
import type { Playout, Slot } from "./playout.ts";
import { Boxes, expected, velocityOf, type Watcher } from "./sight.ts";

const MOST_GROUPS = 64;

export interface Lack {
  slot: Slot;
  tile: number;
}

/** Makes fetch plans for sessions over one package. Moments are seconds of the downloader's clock. */
export interface Planner {
  /** The tiles, ascending, that come in one batch with the segment at a position, whose tables are there. */
  plan(position: number, nowS: number): readonly number[];
  /** Lists what is to be fetched late, the most urgent first. */
  lacking(nowS: number): Lack[];
}

export const whole = ({ tiles }: Offers): Planner => ({ plan: () => tiles, lacking: () => [] });

/** Tiles come as they are expected in sight. */
export class ByView implements Planner {
  readonly #boxes = new Recent<number, Boxes>(MOST_GROUPS);

  constructor(
    private readonly offers: Offers,
    private readonly playout: Playout,
    private readonly watcher: Pick<Watcher, "at">,
  ) {}

  /** Never without a tile that has rows, and with all of these while nobody looks. */
  plan(position: number, nowS: number): readonly number[] {
    const startS = this.playout.startsAtS(this.playout.dueAt(nowS), nowS);
    const off = this.#off(position, nowS, startS, startS + this.offers.secondsAt(position) / this.playout.speed);
    const most = Math.max(EARLY_MARGIN, Math.min(...off));
    const inSight = this.offers.tiles.filter((tile) => off[tile] <= most && off[tile] < Infinity);
    return inSight.length ? inSight : this.offers.tilesWithRows(this.offers.index(position));
  }

  /** The first segment first, then what is nearest to the middle of the picture. */
  lacking(nowS: number): Lack[] {
    const found: Lack[] = [];
    for (const slot of this.playout.unfinished(nowS)) {
      const startS = this.playout.startS(slot, nowS);
      if (startS > nowS + SOON_S) break;
      const off = this.#off(slot.position, nowS, startS, this.playout.endS(slot, nowS));
      const tiles = this.offers.tiles.filter((tile) => off[tile] <= LATE_MARGIN && !slot.tiles.has(tile));
      tiles.sort((a, b) => off[a] - off[b]);
      found.push(...tiles.map((tile) => ({ slot, tile })));
    }
    return found;
  }

  /** (P) degrees that each tile is beside the pictures expected of a span of time; Infinity for one without rows. */
  #off(position: number, nowS: number, startS: number, stopS: number): number[] {
    const { tables, tiles } = this.offers;
    const segment = this.offers.index(position);
    const group = tables.groupOf(segment);
    const boxes = this.#boxes.of(group, () => new Boxes(tables.boxes(group)));
    const views = this.#expected(nowS, startS, stopS).map((view) => boxes.degreesOff(view));
    const off = tiles.map(() => Infinity);
    for (const tile of this.offers.tilesWithRows(segment)) {
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

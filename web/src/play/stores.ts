// What a player has of a package beside deltas: which tables it has read, which keyframe tiers it has decoded, what it knows
// of the link. It outlives a session: after a seek another one goes on with it.
import { Recent } from "../format/collections.ts";
import type { FormatError } from "../format/errors.ts";
import { groupPath, isSound, isTable } from "../format/paths.ts";
import { type Arrival, usableFiles } from "./downloader.ts";
import type { Option } from "./ladder.ts";
import { type Batch, filesOf, missing, type Offers, optionsOf } from "./offers.ts";
import type { Download } from "./policies/state.ts";

/** Files that are known to have come; those of more were played long ago. */
const MOST_PATHS = 4096;

/** Pages of the index and tables of groups, fetched once, as long as the tables have them. */
export class TableStore {
  private readonly paths = new Recent<string, true>(MOST_PATHS);

  constructor(private readonly offers: Offers) {}

  add(arrival: Arrival): void {
    for (const path of usableFiles(arrival)) if (isTable(path)) this.paths.set(path, true);
  }

  has(position: number): boolean {
    return this.next(this.offers.index(position)) === null;
  }

  /** Lists pages that positions [start, stop) still need, and tables that pages that are read, or the root, lead to. */
  missing(start: number, stop: number): string[] {
    const wanted = Array.from({ length: stop - start }, (_, i) => this.next(this.offers.index(start + i)) ?? []);
    return [...new Set(wanted.flat())];
  }

  private next(segment: number): string | null {
    // Of those that came, the tables that were last used stay.
    for (const [path, there] of this.pathsTo(segment)) if (!there || !this.paths.has(path)) return path;
    return null;
  }

  /** Tables that lead to a segment, then those to the base of its group; whether `offers.tables` have each. */
  private *pathsTo(segment: number): Generator<[path: string, there: boolean]> {
    const { tables } = this.offers;
    const { index } = tables;
    for (const path of index.pagesTo("segments", segment)) yield [path, index.hasPage(path)];
    const group = tables.groupOf(segment);
    yield [groupPath(group + 1), tables.has(group)];
    const base = tables.base(group);
    if (base === null) return;
    for (const path of index.pagesTo("groups", base)) yield [path, index.hasPage(path)];
    yield [groupPath(base + 1), tables.has(base)];
  }
}

/** Keyframe tiers of a loop that are known; more were played long ago. */
const MOST_KEYFRAMES = 32768;

/** Keyframe tiers, decoded once a loop over the sequence. */
export class KeyframeStore {
  private readonly loops = new Map<number, Recent<number, true>>();

  constructor(private readonly offers: Offers) {}

  /** Forget the loops before that of a position: what is buffered of a short sequence may be hundreds of loops. */
  forget(before: number): void {
    const { loop: first } = this.offers.place(before);
    for (const loop of this.loops.keys()) if (loop < first) this.loops.delete(loop);
  }

  decoded(position: number): Recent<number, true> {
    const { loop } = this.offers.place(position);
    const keyframes = this.loops.get(loop) ?? new Recent<number, true>(MOST_KEYFRAMES);
    this.loops.set(loop, keyframes);
    return keyframes;
  }

  /** How many tiers of a keyframe quality, from the first on, can be shown in the group of a position. */
  shownTiers(position: number, quality: number): number {
    const { levels, tiers } = this.offers.tables.root;
    const { rungs } = this.offers.of(this.offers.index(position));
    const decoded = this.decoded(position);
    const wanted = rungs[quality * levels.length].keyframes.filter(
      ({ tier, number }) => tier >= 0 && !decoded.has(number),
    );
    return Math.min(tiers, ...wanted.map(({ tier }) => tier));
  }

  missing(position: number, rung: number): Batch {
    return missing(this.offers.of(this.offers.index(position)), rung, this.decoded(position));
  }

  options(position: number): Option[] {
    return optionsOf(this.offers.of(this.offers.index(position)), this.decoded(position));
  }

  /** Take in what arrived: a keyframe tier counts once its files are there; sound that cannot be had is silence. */
  add(arrival: Arrival): void {
    const { position, rung } = arrival.request;
    const segment = this.offers.index(position);
    const there = new Set([...usableFiles(arrival), ...[...arrival.refused.keys()].filter(isSound)]);
    for (const { number, files } of this.offers.of(segment).rungs[rung].keyframes) {
      if (files.every((path) => there.has(path))) this.decoded(position).set(number, true);
    }
  }
}

export class Stores {
  readonly tables: TableStore;
  readonly keyframes: KeyframeStore;
  readonly downloads: Download[] = [];
  /** The fastest of tables and poster, the wait for its first byte included. */
  first: Download = { bytes: 0, seconds: 1 };
  readonly unusable = new Map<string, FormatError>();
  /** When airgs.json was asked for; null: not yet. */
  rootS: number | null = null;

  constructor(private readonly offers: Offers) {
    this.tables = new TableStore(offers);
    this.keyframes = new KeyframeStore(offers);
  }

  /** Why no rung of the segment at a position can be had; undefined: nobody knows. */
  whyLost(position: number): FormatError | undefined {
    const tables = this.tables.missing(position, position + 1);
    const least = tables.length ? tables : filesOf(this.keyframes.missing(position, this.offers.rungs.length - 1));
    return least.map((path) => this.unusable.get(path)).find(Boolean);
  }
}

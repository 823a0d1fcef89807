// What a player has of a package beside states: which tables it has read, which key units it has decoded, what it knows
// of the link. It outlives a session: after a seek another one goes on with it.
import { groupPath } from "../format/paths.ts";
import { type Batch, type Catalogue, type KeyUnits, NONE } from "./catalogue.ts";
import { type Arrival, keptFiles } from "./events.ts";
import type { Option } from "./ladder.ts";
import type { Download } from "./policies/state.ts";

/** Pages of the index and tables of groups are fetched once, also where the sequence is played again. */
export class TableStore {
  private readonly paths = new Set<string>();

  constructor(private readonly catalogue: Catalogue) {}

  /** Keep what arrived. */
  add(arrival: Arrival): void {
    for (const path of keptFiles(arrival)) this.paths.add(path);
  }

  /** Whether the table of the segment at a position is there. */
  has(position: number): boolean {
    return !this.missing(position, position + 1).length;
  }

  /** What positions [start, stop) still need: pages, and tables that a page that was read, or the root, leads to. */
  missing(start: number, stop: number): string[] {
    const wanted = new Set<string>();
    for (let position = start; position < stop; position++) {
      const path = this.next(this.catalogue.index(position));
      if (path !== null) wanted.add(path);
    }
    return [...wanted];
  }

  /** Pages of the index with segments of the session. */
  missingPages(): string[] {
    return this.catalogue.tables.index.missingPages(this.catalogue.first, (path) => this.paths.has(path));
  }

  /** The first that is missing of what leads to a segment, and then to the group whose rows its group keeps. */
  private next(segment: number): string | null {
    const { tables } = this.catalogue;
    const page = this.nextPage(tables.index.pagesTo("segments", segment));
    if (page !== null) return page;
    const group = tables.groupOf(segment);
    const path = this.nextTable(group);
    if (path !== null) return path;
    const base = tables.base(group);
    return base === null ? null : (this.nextPage(tables.index.pagesTo("groups", base)) ?? this.nextTable(base));
  }

  private nextPage(way: Iterable<string>): string | null {
    for (const path of way) if (!this.paths.has(path)) return path;
    return null;
  }

  private nextTable(group: number): string | null {
    const path = groupPath(group + 1);
    return this.paths.has(path) && this.catalogue.tables.has(group) ? null : path; // those last used are kept, not all
  }
}

/** Groups whose keys are known; those of more were played long ago. */
const MOST_GROUPS = 1024;

/** Key units are kept by loop and group: a group that is played again is fetched again. */
export class KeyStore {
  private readonly units = new Map<string, { loop: number; group: number; units: Set<number> }>();

  constructor(private readonly catalogue: Catalogue) {}

  /** The units that are decoded of the groups of a position's loop, by group. */
  decoded(position: number): Map<number, KeyUnits> {
    const { loop } = this.catalogue.place(position);
    const found = [...this.units.values()].filter((entry) => entry.loop === loop);
    return new Map(found.map(({ group, units }) => [group, units]));
  }

  /** Those of the group of a position, and of the group whose rows it keeps. */
  private of(position: number): [KeyUnits, KeyUnits] {
    const { loop, group } = this.catalogue.group(position);
    const base = this.catalogue.tables.base(group);
    const held = (of: number | null) => this.units.get(`${loop}:${of}`)?.units ?? NONE;
    return [held(group), held(base)];
  }

  /** How many tiers of a tile in a key quality, from the first on, can be shown in the group of a position. */
  shownTiers(position: number, quality: number, tile: number): number {
    const { tables } = this.catalogue;
    const { group } = this.catalogue.group(position);
    const [own, base] = this.of(position);
    const { tiers } = tables.root;
    for (let tier = 0; tier < tiers; tier++) {
      const number = this.catalogue.unit(quality, tile * tiers + tier);
      if (!own.has(number)) return tier;
      if (!base.has(number) && tables.keptFiles(group, tile * tiers + tier, quality).length) return tier;
    }
    return tiers;
  }

  /** The files that a rung of the segment at a position still needs of some tiles. */
  missing(position: number, rung: number, tiles = this.catalogue.tiles): Batch {
    return this.catalogue.ofTiles(tiles).batch(this.catalogue.index(position), rung, ...this.of(position));
  }

  /** Every rung of the segment at a position, with the bytes that it still needs of some tiles. */
  options(position: number, tiles = this.catalogue.tiles): readonly Option[] {
    return this.catalogue.ofTiles(tiles).options(this.catalogue.index(position), ...this.of(position));
  }

  /** Take in what arrived: a unit counts once its files are there. */
  add(arrival: Arrival): void {
    const { rungs, tables } = this.catalogue;
    const { position, rung } = arrival.request;
    const [quality, level] = rungs[rung];
    const { loop, group } = this.catalogue.group(position);
    const kept = new Set(keptFiles(arrival));
    for (const of of [group, tables.base(group)]) {
      if (of === null) continue;
      const name = `${loop}:${of}`;
      const { units } = this.units.get(name) ?? { units: new Set<number>() };
      this.units.delete(name); // the order of a Map is that of adding: the last used is the last
      this.units.set(name, { loop, group: of, units });
      if (this.units.size > MOST_GROUPS) this.units.delete(this.units.keys().next().value ?? name);
      for (const unit of tables.unitsOf(level)) {
        const whole = tables.keyFiles(of, unit, quality).every((path) => kept.has(path));
        if (whole) units.add(this.catalogue.unit(quality, unit));
      }
    }
  }

  /** The keys of a group are no longer at hand: they are fetched again where they are needed. */
  forget(of: { loop: number; group: number }): void {
    this.units.delete(`${of.loop}:${of.group}`);
  }
}

/** Files on their way, each as often as it was asked for. */
export class Coming {
  private readonly counts = new Map<string, number>();

  has(path: string): boolean {
    return this.counts.has(path);
  }

  /** They were asked for. */
  add(paths: readonly string[]): void {
    for (const path of paths) this.counts.set(path, (this.counts.get(path) ?? 0) + 1);
  }

  /** They have come, or will not come, of those asked for together. */
  remove(paths: readonly string[]): void {
    for (const path of paths) {
      const count = (this.counts.get(path) ?? 0) - 1;
      if (count > 0) this.counts.set(path, count);
      else this.counts.delete(path);
    }
  }
}

/** What sessions over one package share. */
export class Stores {
  readonly tables: TableStore;
  readonly keys: KeyStore;
  /** With their arrivals, oldest first. */
  readonly downloads: { atS: number; download: Download }[] = [];
  readonly coming = new Coming();
  /** Files found missing or corrupt. */
  readonly unusable = new Set<string>();
  /** When airgs.json was asked for; null: not yet. */
  rootS: number | null = null;

  constructor(catalogue: Catalogue) {
    this.tables = new TableStore(catalogue);
    this.keys = new KeyStore(catalogue);
  }
}

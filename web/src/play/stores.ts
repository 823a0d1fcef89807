// What a player has of a package beside states: which tables it has read, which key units it has decoded, what it knows
// of the link. It outlives a session: after a seek another one goes on with it.
import { groupPath, pagePath } from "../format/paths.ts";
import { type Batch, type Catalogue, type DecodedTiers, NONE } from "./catalogue.ts";
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
    const { index } = this.catalogue.tables;
    const first = index.pageOfSegment(this.catalogue.first) ?? index.pages;
    const paths = Array.from({ length: index.pages - first }, (_, i) => pagePath(first + i + 1));
    return paths.filter((path) => !this.paths.has(path));
  }

  /** The first that is missing of page and table of a segment's group, then of the group whose rows it keeps. */
  private next(segment: number): string | null {
    const { tables } = this.catalogue;
    const page = this.nextPage(tables.index.pageOfSegment(segment));
    if (page !== null) return page;
    const group = tables.groupOf(segment);
    const path = this.nextTable(group);
    if (path !== null) return path;
    const base = tables.base(group);
    return base === null ? null : (this.nextPage(tables.index.pageOfGroup(base)) ?? this.nextTable(base));
  }

  private nextPage(page: number | null): string | null {
    return page === null || this.paths.has(pagePath(page + 1)) ? null : pagePath(page + 1);
  }

  private nextTable(group: number): string | null {
    const path = groupPath(group + 1);
    return this.paths.has(path) && this.catalogue.tables.has(group) ? null : path; // those last used are kept, not all
  }
}

/** Groups whose keys are known; those of more were played long ago. */
const MOST_GROUPS = 1024;

/** Keys are kept by loop and group: a group that is played again is fetched again. */
export class KeyStore {
  private readonly units = new Map<string, Set<string>>(); // qualities and tiers that are decoded

  constructor(private readonly catalogue: Catalogue) {}

  /** What is decoded of the group of a position. */
  decodedTiers(position: number): DecodedTiers {
    const { loop, group } = this.catalogue.group(position);
    return this.firstTiers(loop, group, () => true);
  }

  /** The same of the group whose rows that group keeps, where tiers that keep none count as decoded. */
  baseTiers(position: number): DecodedTiers {
    const { tables } = this.catalogue;
    const { loop, group } = this.catalogue.group(position);
    const base = tables.base(group);
    return base === null ? NONE : this.firstTiers(loop, base, (tier) => tables.keptFiles(group, tier, 0).length > 0);
  }

  /** How many tiers of a key quality can be shown in the group of a position. */
  shownTiers(position: number, quality: number): number {
    const own = this.decodedTiers(position).get(quality) ?? 0;
    const alone = this.catalogue.tables.base(this.catalogue.group(position).group) === null;
    return alone ? own : Math.min(own, this.baseTiers(position).get(quality) ?? 0);
  }

  /** The files that a rung of the segment at a position still needs. */
  missing(position: number, rung: number): Batch {
    const c = this.catalogue;
    return c.batch(c.index(position), rung, this.decodedTiers(position), this.baseTiers(position));
  }

  /** Every rung of the segment at a position, with the bytes that it still needs. */
  options(position: number): readonly Option[] {
    const c = this.catalogue;
    return c.options(c.index(position), this.decodedTiers(position), this.baseTiers(position));
  }

  /** Take in what arrived: a tier counts once its files are there. */
  add(arrival: Arrival): void {
    const { rungs, tables } = this.catalogue;
    const { position, rung } = arrival.request;
    const [quality, level] = rungs[rung];
    const { loop, group } = this.catalogue.group(position);
    const kept = new Set(keptFiles(arrival));
    for (const of of [group, tables.base(group)]) {
      if (of === null) continue;
      const name = `${loop}:${of}`;
      const units = this.units.get(name) ?? new Set<string>();
      this.units.delete(name); // the order of a Map is that of adding: the last used is the last
      this.units.set(name, units);
      if (this.units.size > MOST_GROUPS) this.units.delete(this.units.keys().next().value ?? name);
      for (let tier = 0; tier < tables.root.levels[level].tiers; tier++) {
        if (tables.keyFiles(of, tier, quality).every((path) => kept.has(path))) units.add(`${quality} ${tier}`);
      }
    }
  }

  /** The keys of a group are no longer at hand: they are fetched again where they are needed. */
  forget(of: { loop: number; group: number }): void {
    this.units.delete(`${of.loop}:${of.group}`);
  }

  /** Key quality → how many tiers of a group, from the first on, are decoded or not needed, where some are. */
  private firstTiers(loop: number, group: number, needed: (tier: number) => boolean): DecodedTiers {
    const { tiers, qualities } = this.catalogue.tables.root;
    const units = this.units.get(`${loop}:${group}`);
    const found = new Map<number, number>();
    for (const quality of qualities.keys()) {
      let count = 0;
      while (count < tiers && (!needed(count) || units?.has(`${quality} ${count}`))) count++;
      if (count) found.set(quality, count);
    }
    return found;
  }
}

/** What sessions over one package share. */
export class Stores {
  readonly tables: TableStore;
  readonly keys: KeyStore;
  /** With their arrivals, oldest first. */
  readonly downloads: { atS: number; download: Download }[] = [];
  /** Files found missing or corrupt. */
  readonly unusable = new Set<string>();
  /** When airgs.json was asked for; null: not yet. */
  rootS: number | null = null;

  constructor(catalogue: Catalogue) {
    this.tables = new TableStore(catalogue);
    this.keys = new KeyStore(catalogue);
  }
}

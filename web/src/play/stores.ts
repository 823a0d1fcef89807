// What a player has of a package beside states: which tables it has read, which key units it has decoded, what it knows
// of the link. It outlives a session: after a seek another one goes on with it.
import { groupPath, pagePath } from "../format/paths.ts";
import type { Batch, Catalogue, DecodedTiers } from "./catalogue.ts";
import { type Arrival, keptFiles } from "./events.ts";
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

  private next(segment: number): string | null {
    const { tables } = this.catalogue;
    const page = tables.index.pageOfSegment(segment);
    if (page !== null && !this.paths.has(pagePath(page + 1))) return pagePath(page + 1);
    const group = tables.groupOf(segment);
    const path = groupPath(group + 1);
    return this.paths.has(path) && tables.has(group) ? null : path; // the tables last used are kept, not all
  }
}

/** Groups whose keys are known; those of more were played long ago. */
const MOST_GROUPS = 1024;

/** Keys are kept by loop and group: a group that is played again is fetched again. */
export class KeyStore {
  private readonly tiers = new Map<string, Map<number, number>>(); // key quality → decoded tiers

  constructor(private readonly catalogue: Catalogue) {}

  /** What is decoded of the group of a position. */
  decodedTiers(position: number): DecodedTiers {
    const { loop, group } = this.catalogue.group(position);
    return this.tiers.get(`${loop}:${group}`) ?? new Map();
  }

  /** The files that a rung of the segment at a position still needs. */
  missing(position: number, rung: number): Batch {
    return this.catalogue.batch(this.catalogue.index(position), rung, this.decodedTiers(position));
  }

  /** Take in what arrived: a tier counts once its files are there. */
  add(arrival: Arrival): void {
    const { rungs, tables } = this.catalogue;
    const { position, rung } = arrival.request;
    const [quality, level] = rungs[rung];
    const { loop, group } = this.catalogue.group(position);
    const name = `${loop}:${group}`;
    const tiers = this.tiers.get(name) ?? new Map<number, number>();
    this.tiers.set(name, tiers);
    if (this.tiers.size > MOST_GROUPS) this.tiers.delete(this.tiers.keys().next().value ?? name); // of the oldest
    const kept = new Set(keptFiles(arrival));
    for (let tier = tiers.get(quality) ?? 0; tier < tables.root.levels[level].tiers; tier++) {
      if (!tables.keyFiles(group, tier, quality).every((path) => kept.has(path))) return;
      tiers.set(quality, tier + 1);
    }
  }

  /** The keys of a group are no longer at hand: they are fetched again where they are needed. */
  forget(of: { loop: number; group: number }): void {
    this.tiers.delete(`${of.loop}:${of.group}`);
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

// What a package offers a viewer, as numbers: wire bytes and qualities of every choice.
//
// S segments, G groups, P tiles, U key units, Q key qualities, L levels. A unit is a key tier of a tile. A rung is a key
// quality with a level; rungs are numbered quality by quality. A position is a segment of a session, which may play the
// sequence several times.
import { HEADER_BYTES, OVER_BUDGET, ROOT_PATH, SESSION_S } from "../generated/constants.ts";
import { Kept } from "./kept.ts";
import { type Option, savedShares } from "./ladder.ts";
import type { Offers } from "./offers.ts";
import { ConfigError } from "./settings.ts";

/** Segments whose numbers are kept: more than a buffer holds and a policy looks at. */
const KEPT_SEGMENTS = 512;
const KEPT_OPTIONS = 4096;
/** Choices of tiles whose numbers are kept. */
const KEPT_PARTS = 16;

/** Those key units of a group that are decoded: unit k in key quality q is number q U + k. */
export type KeyUnits = ReadonlySet<number>;
export const NONE: KeyUnits = new Set();

/** Paths of the files that are requested together, in the order in which they arrive. */
export interface Batch {
  keys: readonly string[];
  state: readonly string[];
  tables: readonly string[];
}

/** All paths: key units one by one, then the state segment, then tables for what comes next. */
export const filesOf = (batch: Batch): string[] => [...batch.keys, ...batch.state, ...batch.tables];

/** What a package offers. Wire bytes are those of files with `headerBytes` for each.
 *
 * A session over a growing package begins with its newest group (`first`), and its tables grow under it. No rung is
 * offered that shows more Gaussians than the budget has. Sizes are those of `tiles` alone (`ofTiles`); qualities and
 * numbers of Gaussians are those of all.
 */
export class Catalogue {
  /** (key quality, level) of every rung. */
  readonly rungs: readonly (readonly [number, number])[];
  /** The name of every rung, such as Q1+L2. */
  readonly names: readonly string[];
  readonly fps: number;
  /** The segment that a session begins with. */
  first = 0;
  private readonly kept = {
    quality: new Kept<Float64Array>(KEPT_SEGMENTS),
    state: new Kept<Float64Array>(KEPT_SEGMENTS),
    key: new Kept<Float64Array>(KEPT_SEGMENTS),
    base: new Kept<Float64Array>(KEPT_SEGMENTS),
    after: new Kept<Float64Array>(KEPT_SEGMENTS),
    scratch: new Kept<Float64Array>(KEPT_SEGMENTS),
    options: new Kept<readonly Option[], string>(KEPT_OPTIONS),
  };
  /** (L) the key units of every level. */
  private readonly units: readonly (readonly number[])[];
  /** What is decoded of a group after each rung, at least. */
  private readonly held: readonly KeyUnits[];
  private readonly parts = new Kept<Catalogue, string>(KEPT_PARTS);

  constructor(
    readonly tables: Offers,
    readonly headerBytes = HEADER_BYTES,
    readonly budget = Number.POSITIVE_INFINITY,
    /** Ascending. */
    readonly tiles: readonly number[] = Array.from({ length: tables.root.tiles }, (_, tile) => tile),
  ) {
    const { qualities, levels, frame_rate } = tables.root;
    this.rungs = qualities.flatMap((_, q) => levels.map((_, j) => [q, j] as const));
    this.names = this.rungs.map(([q, j]) => `${qualities[q].id}+${levels[j].id}`);
    this.units = levels.map((_, j) => tables.unitsOf(j, tiles));
    this.held = this.rungs.map(([q, j]) => new Set(this.units[j].map((unit) => this.unit(q, unit))));
    this.fps = frame_rate[0] / frame_rate[1];
  }

  /** What some tiles cost, which ascend: the same with their sizes. */
  ofTiles(tiles: readonly number[]): Catalogue {
    if (tiles.length === this.tiles.length) return this;
    const part = this.parts.get(tiles.join(), () => new Catalogue(this.tables, this.headerBytes, this.budget, tiles));
    part.first = this.first;
    return part;
  }

  /** The number of a key unit in a quality. */
  unit(quality: number, unit: number): number {
    return quality * this.tables.root.tiles * this.tables.root.tiers + unit;
  }

  /** How many segments there are, S. */
  get segments(): number {
    return this.tables.index.segments;
  }

  /** More groups may come in this session. */
  get live(): boolean {
    return this.tables.root.live;
  }

  /** Seconds of play of the whole sequence. */
  get durationS(): number {
    return this.tables.root.frames / this.fps;
  }

  /** Whether every rung of every segment has a quality. */
  get measured(): boolean {
    return this.tables.root.views.reference !== "none";
  }

  /** Seconds of play of the last group so far. */
  get newestSeconds(): number {
    const entry = this.tables.index.entry(this.tables.index.groups - 1);
    return (entry.stop - entry.start) / this.fps;
  }

  /** Whether the tables of a segment's group, and of the one whose rows it keeps, are there. */
  knows(segment: number): boolean {
    if (!this.hasTable(segment)) return false;
    const group = this.tables.groupOf(segment);
    return this.tables.has(this.tables.base(group) ?? group);
  }

  private hasTable(segment: number): boolean {
    return this.tables.index.leadsTo(segment) && this.tables.has(this.tables.groupOf(segment));
  }

  /** Frames of a segment; where its table cannot be had, as if its neighbours were of one length. */
  span(segment: number): { start: number; stop: number } {
    return this.hasTable(segment) ? this.tables.segment(segment) : this.tables.index.guessSpan(segment);
  }

  /** Seconds of play of a segment. */
  seconds(segment: number): number {
    const { start, stop } = this.span(segment);
    return (stop - start) / this.fps;
  }

  /** (Q L) PSNR in dB; 0 where it was not measured. */
  quality(segment: number): Float64Array {
    return this.kept.quality.get(segment, () => {
      const { levels } = this.tables.segment(segment);
      return Float64Array.from(this.rungs, ([q, j]) => levels[j].psnr[q] ?? 0);
    });
  }

  /** (Q L) Gaussians that a rung of a segment shows: the rows of its key units in all tiles. */
  rows(segment: number): number[] {
    const rows = this.tables.rows(this.tables.groupOf(segment));
    return this.rungs.map(([, j]) => this.tables.unitsOf(j).reduce((sum, unit) => sum + rows[unit], 0));
  }

  /** Tiles of a segment that have rows. */
  tilesWithRows(segment: number): number[] {
    const rows = this.tables.rows(this.tables.groupOf(segment));
    const { tiers } = this.tables.root;
    return this.tiles.filter((tile) => rows.slice(tile * tiers, (tile + 1) * tiers).some((count) => count > 0));
  }

  /** Throws ConfigError where every rung at a position shows more Gaussians than the budget has. */
  checkBudget(position: number): void {
    const segment = this.index(position);
    const least = this.knows(segment) ? Math.min(...this.rows(segment)) : 0;
    if (least > this.budget) throw new ConfigError(`budget: expected ${least} Gaussians or more, got ${this.budget}`);
  }

  /** (L) wire bytes of a state segment; 0 where there is nothing to fetch. */
  stateBytes(segment: number): Float64Array {
    const levels = this.tables.root.levels;
    return this.kept.state.get(segment, () =>
      Float64Array.from(levels, (_, j) => this.wire(this.tables.stateFiles(segment, j, this.tiles))),
    );
  }

  /** (Q U) wire bytes of the key units of a group; 0 for one without rows. */
  keyBytes(group: number): Float64Array {
    return this.kept.key.get(group, () => this.ofUnits((unit, q) => this.tables.keyFiles(group, unit, q)));
  }

  /** (Q U) wire bytes of key units of the group whose rows a group keeps; 0 for one that keeps none. */
  baseBytes(group: number): Float64Array {
    return this.kept.base.get(group, () => this.ofUnits((unit, q) => this.tables.keptFiles(group, unit, q)));
  }

  private ofUnits(filesOf: (unit: number, quality: number) => string[]): Float64Array {
    const { qualities } = this.tables.root;
    const units = this.unit(1, 0);
    return Float64Array.from({ length: qualities.length * units }, (_, i) =>
      this.wire(filesOf(i % units, Math.floor(i / units))),
    );
  }

  /** (Q L · Q L) wire bytes of rung c after rung p in the segment before, of the same group, at place p Q L + c. */
  bytesAfter(segment: number): Float64Array {
    return this.kept.after.get(segment, () => this.table(this.held, (held) => this.prices(segment, held, held)));
  }

  /**
   * (Q L · Q L) wire bytes of rung c in the first segment of a group after rung p in the one before, at place p Q L + c;
   * (Q L) where the rung before makes no difference. It does where the group keeps rows of the one before, or of the same
   * as that. `known` are keys decoded before, in the same loop, by group.
   */
  bytesAtStart(segment: number, known: ReadonlyMap<number, KeyUnits>): Float64Array {
    const base = this.tables.base(this.tables.groupOf(segment));
    if (base === null) return this.bytesFromScratch(segment);
    const held = known.get(base) ?? NONE;
    return this.table(this.baseAfter(segment, base), (after) =>
      this.prices(segment, NONE, new Set([...held, ...after])),
    );
  }

  /** What is decoded of a base after each rung of the segment before; [NONE] where that tells nothing of it. */
  private baseAfter(segment: number, base: number): readonly KeyUnits[] {
    const { tables } = this;
    const before = tables.groupOf(segment) - 1;
    if (base === before) return this.held;
    if (base !== tables.base(before)) return [NONE];
    const kept = (unit: number) => tables.keptFiles(before, unit % this.unit(1, 0), 0).length > 0;
    return this.held.map((units) => new Set([...units].filter(kept)));
  }

  private table(rows: readonly KeyUnits[], row: (held: KeyUnits) => Float64Array): Float64Array {
    const table = new Float64Array(rows.length * this.rungs.length);
    for (const [p, held] of rows.entries()) table.set(row(held), p * this.rungs.length);
    return table;
  }

  /** (Q L) wire bytes of a rung when no key of its group is decoded, nor of one whose rows it keeps. */
  bytesFromScratch(segment: number): Float64Array {
    return this.kept.scratch.get(segment, () => this.prices(segment, NONE));
  }

  /** What `sizes` gives; OVER_BUDGET for rungs that show too many Gaussians. */
  private prices(segment: number, decoded: KeyUnits, base?: KeyUnits): Float64Array {
    const rows = this.rows(segment);
    return this.sizes(segment, decoded, base).map((size, rung) => (rows[rung] > this.budget ? OVER_BUDGET : size));
  }

  /** (Q L) wire bytes of the keys that are missing, of the group and of the one whose rows it keeps, and the state. */
  sizes(segment: number, decoded: KeyUnits, base: KeyUnits = NONE): Float64Array {
    const group = this.tables.groupOf(segment);
    const states = this.stateBytes(segment);
    const keys = [[this.keyBytes(group), decoded] as const, [this.baseBytes(group), base] as const];
    return Float64Array.from(this.rungs, ([q, j]) => {
      let size = states[j];
      for (const unit of this.units[j].map((k) => this.unit(q, k))) {
        for (const [bytes, held] of keys) if (!held.has(unit)) size += bytes[unit];
      }
      return size;
    });
  }

  /** Every rung of a segment that the budget allows, by number; kept, since sessions ask for few combinations. */
  options(segment: number, decoded: KeyUnits, base: KeyUnits = NONE): readonly Option[] {
    const held = [decoded, base].map((units) => [...units].sort((a, b) => a - b).join(" "));
    return this.kept.options.get(`${segment}: ${held.join("; ")}`, () => {
      const quality = this.quality(segment);
      const sizes = this.prices(segment, decoded, base);
      const saved = savedShares(this.stateBytes(segment));
      return this.rungs.flatMap(([, j], index) => {
        const sizeBytes = sizes[index];
        return sizeBytes < OVER_BUDGET ? { index, sizeBytes, quality: quality[index], saved: saved[j] } : [];
      });
    });
  }

  /** The levels of a segment by the bytes of their states and their quality with the finest keys. */
  levels(segment: number): Option[] {
    const sizes = this.stateBytes(segment);
    const quality = this.quality(segment);
    return savedShares(sizes).map((saved, j) => ({ index: j, sizeBytes: sizes[j], quality: quality[j], saved }));
  }

  /** The files that a rung of a segment needs beside the decoded units of its group, and of the one whose rows it keeps. */
  batch(segment: number, rung: number, decoded: KeyUnits, base: KeyUnits = NONE): Batch {
    const { tables } = this;
    const [q, j] = this.rungs[rung];
    const group = tables.groupOf(segment);
    const keys: string[] = [];
    for (const unit of this.units[j]) {
      if (!decoded.has(this.unit(q, unit))) keys.push(...tables.keyFiles(group, unit, q));
      if (!base.has(this.unit(q, unit))) keys.push(...tables.keptFiles(group, unit, q));
    }
    return { keys, state: tables.stateFiles(segment, j, this.tiles), tables: [] };
  }

  /** The segment of the package that a session plays at a position. */
  index(position: number): number {
    return this.place(position).segment;
  }

  /** The loop, from 0, and the segment that a session plays at a position. */
  place(position: number): { loop: number; segment: number } {
    const at = this.first + position;
    const loop = Math.floor(at / this.segments);
    return { loop, segment: at - loop * this.segments };
  }

  /** How many positions a session has that plays the sequence so often, as far as is known. */
  end(loops: number): number {
    return loops * this.segments - this.first;
  }

  /** The loop and the group that a position belongs to; its keys are fetched once. */
  group(position: number): { loop: number; group: number } {
    const { loop, segment } = this.place(position);
    return { loop, group: this.tables.groupOf(segment) };
  }

  /** Seconds of play at a position. */
  secondsAt(position: number): number {
    return this.seconds(this.index(position));
  }

  /** The segments of the next positions before `end`, as far as their tables are there: (segment, whether it begins a
   * group). */
  upcoming(position: number, count: number, end: number): { segment: number; startsGroup: boolean }[] {
    const found = [];
    for (let p = position; p < Math.min(position + count, end); p++) {
      const segment = this.index(p);
      if (!this.knows(segment)) break;
      found.push({ segment, startsGroup: this.startsGroup(segment) });
    }
    return found;
  }

  /** Whether a segment begins a group, so that no key of it is decoded. */
  startsGroup(segment: number): boolean {
    return segment === this.tables.index.entry(this.tables.groupOf(segment)).firstSegment;
  }

  /** How often the sequence is played: as wanted, else for about SESSION_S; once while it grows. */
  loops(wanted: number | null): number {
    if (this.live) return 1;
    return wanted ?? Math.max(1, roundHalfEven(SESSION_S / this.durationS));
  }

  /** Bytes of a file without headers. */
  fileBytes(path: string): number {
    return path === ROOT_PATH ? this.tables.rootBytes : this.tables.entry(path).bytes;
  }

  /** Bytes of files with their headers. */
  wire(paths: readonly string[]): number {
    return paths.reduce((sum, path) => sum + this.fileBytes(path), this.headerBytes * paths.length);
  }
}

/** The nearest whole number, of two the even one: as Python rounds. */
export function roundHalfEven(value: number): number {
  const whole = Math.round(value);
  return whole - value === 0.5 && whole % 2 ? whole - 1 : whole;
}

// What a package offers a player: one frozen value a segment, made once from the tables of its group.
//
// Q keyframe qualities, L levels. A rung is a keyframe quality with a level; rungs are numbered quality by quality. A position is a
// segment of a session, which may play the sequence several times. Wire bytes are those of files with their headers.
import { Recent } from "../format/collections.ts";
import type { GroupIndex } from "../format/index.ts";
import type { Tables } from "../format/package.ts";
import type { Root, Segment } from "../format/types.ts";
import { HEADER_BYTES, OVER_BUDGET, ROOT_PATH } from "../generated/constants.ts";
import { type Option, savedShares } from "./ladder.ts";

/** Settings that cannot work, or a policy that does not exist. */
export class ConfigError extends Error {
  override name = "ConfigError";
}

/** More than a buffer holds and a policy looks at. */
const MOST_OFFERS = 1024;

/** Numbers of keyframe tiers, such as those that are decoded in a loop over the sequence. */
export type Keyframes = Pick<ReadonlySet<number>, "has">;
export const NONE: Keyframes = new Set();

/** A keyframe tier, or the sound of a group, whose number is negative. */
export interface KeyframeOffer {
  /** Of the tier among those of all groups and qualities. */
  readonly number: number;
  readonly group: number;
  readonly tier: number;
  readonly files: readonly string[];
  readonly bytes: number;
}

export interface RungOffer {
  readonly quality: number;
  readonly level: number;
  /** dB; 0 where it was not measured. */
  readonly psnr: number;
  readonly gaussians: number;
  /** Whether the budget has as many, and its level is offered. */
  readonly allowed: boolean;
  /** Share of the first level's delta bytes that its level saves. */
  readonly saved: number;
  /** In the order of fetching: sound, then each tier of the group with files, followed by that of its base. */
  readonly keyframes: readonly KeyframeOffer[];
  readonly delta: readonly string[];
  readonly deltaBytes: number;
}

/** What a segment offers; frames are [start, stop). */
export interface SegmentOffer {
  readonly segment: number;
  readonly start: number;
  readonly stop: number;
  readonly seconds: number;
  readonly group: number;
  /** The group whose rows its group reuses; null: it reuses none. */
  readonly base: number | null;
  readonly startsGroup: boolean;
  readonly rungs: readonly RungOffer[];
}

/** Paths of the files that are requested together, in the order in which they arrive. */
export interface Batch {
  keyframes: readonly string[];
  delta: readonly string[];
  tables: readonly string[];
}

/** All paths: keyframe tiers one by one, then the delta segment, then tables for what comes next. */
export const filesOf = (batch: Batch): string[] => [...batch.keyframes, ...batch.delta, ...batch.tables];

/** (Q L) wire bytes of every rung beside the decoded keyframe tiers; OVER_BUDGET where it shows too many Gaussians. */
export const sizesOf = ({ rungs }: SegmentOffer, decoded: Keyframes): Float64Array =>
  Float64Array.from(rungs, ({ allowed, keyframes, deltaBytes }) =>
    allowed
      ? keyframes.reduce((sum, { number, bytes }) => sum + (decoded.has(number) ? 0 : bytes), deltaBytes)
      : OVER_BUDGET,
  );

export function optionsOf(offer: SegmentOffer, decoded: Keyframes): Option[] {
  const sizes = sizesOf(offer, decoded);
  const all = offer.rungs.map(({ psnr, saved }, index) => ({ index, sizeBytes: sizes[index], quality: psnr, saved }));
  return all.filter(({ index }) => offer.rungs[index].allowed);
}

export function missing({ rungs }: SegmentOffer, rung: number, decoded: Keyframes): Batch {
  const { keyframes, delta } = rungs[rung];
  return { keyframes: keyframes.flatMap(({ number, files }) => (decoded.has(number) ? [] : files)), delta, tables: [] };
}

/** The tables of a package as far as a player looks at them; they may be numbers alone. All count from 0. */
export interface OfferTables
  extends Pick<
    Tables,
    "rootBytes" | "has" | "groupOf" | "rows" | "base" | "keyframeFiles" | "deltaFiles" | "soundFiles"
  > {
  readonly root: Pick<Root, "frame_rate" | "live" | "tiers" | "frames"> & {
    readonly views: Pick<Root["views"], "reference">;
    readonly qualities: readonly Pick<Root["qualities"][number], "id">[];
    readonly levels: readonly Pick<Root["levels"][number], "id" | "tiers">[];
  };
  readonly index: GroupIndex;
  segment(segment: number): Pick<Segment, "start" | "stop"> & { levels: readonly { psnr: readonly number[] }[] };
  entry(path: string): { bytes: number };
}

/** Offers of a package, whose tables grow under it; a session over a growing one begins with `first`. */
export class Offers {
  readonly rungs: readonly (readonly [number, number])[]; // (keyframe quality, level)
  readonly names: readonly string[];
  readonly fps: number;
  first = 0;
  #made = new Recent<number, SegmentOffer>(MOST_OFFERS);
  #finest = 0;

  constructor(
    readonly tables: OfferTables,
    readonly headerBytes = HEADER_BYTES,
    readonly budget = Number.POSITIVE_INFINITY,
  ) {
    const { qualities, levels, frame_rate } = tables.root;
    this.rungs = qualities.flatMap((_, q) => levels.map((_, j) => [q, j] as const));
    this.names = this.rungs.map(([q, j]) => `${qualities[q].id}+${levels[j].id}`);
    this.fps = frame_rate[0] / frame_rate[1];
  }

  get finest(): number {
    return this.#finest;
  }

  set finest(level: number) {
    if (level !== this.#finest) this.#made = new Recent(MOST_OFFERS);
    this.#finest = level;
  }

  /** The offer of a segment, whose tables are there (`knows`). */
  of(segment: number): SegmentOffer {
    return this.#made.of(segment, () => this.#make(segment));
  }

  #make(segment: number): SegmentOffer {
    const { tables, fps } = this;
    const group = tables.groupOf(segment);
    const { start, stop, levels } = tables.segment(segment);
    const rows = tables.rows(group);
    const deltas = levels.map((_, level) => tables.deltaFiles(segment, level));
    const bytes = deltas.map((files) => this.wire(files));
    const saved = savedShares(bytes);
    const sound = tables.soundFiles(group).map((path) => {
      return { number: -1 - group, group, tier: -1, files: [path], bytes: this.wire([path]) };
    });
    const rungs = this.rungs.map(([quality, level]) => {
      const shown = rows.slice(0, tables.root.levels[level].tiers);
      const gaussians = shown.reduce((sum, count) => sum + count, 0);
      const keyframes = [...sound, ...shown.flatMap((_, tier) => this.#keyframes(group, quality, tier))];
      const psnr = levels[level].psnr[quality] ?? 0;
      const [delta, deltaBytes] = [deltas[level], bytes[level]];
      const allowed = gaussians <= this.budget && level >= this.finest;
      return { quality, level, psnr, gaussians, allowed, saved: saved[level], keyframes, delta, deltaBytes };
    });
    const startsGroup = segment === tables.index.entry(group).firstSegment;
    const seconds = (stop - start) / fps;
    return Object.freeze({ segment, start, stop, seconds, group, base: tables.base(group), startsGroup, rungs });
  }

  #keyframes(group: number, quality: number, tier: number): KeyframeOffer[] {
    const { tables } = this;
    const { qualities, tiers } = tables.root;
    const offers = [group, tables.base(group) ?? []].flat().map((of) => {
      const files = tables.keyframeFiles(of, tier, quality);
      const number = (of * qualities.length + quality) * tiers + tier;
      return { number, group: of, tier, files, bytes: this.wire(files) };
    });
    return offers.filter(({ files }) => files.length);
  }

  get segments(): number {
    return this.tables.index.segments;
  }

  get live(): boolean {
    return this.tables.root.live;
  }

  get durationS(): number {
    return this.tables.root.frames / this.fps;
  }

  get measured(): boolean {
    return this.tables.root.views.reference !== "none";
  }

  /** Whether the tables of a segment's group, and of its base, are there. */
  knows(segment: number): boolean {
    if (!this.#hasTable(segment)) return false;
    const group = this.tables.groupOf(segment);
    return this.tables.has(this.tables.base(group) ?? group);
  }

  #hasTable(segment: number): boolean {
    return this.tables.index.leadsTo(segment) && this.tables.has(this.tables.groupOf(segment));
  }

  /** Frames of the segment at a position; where its table cannot be had, as if its neighbours were of one length. */
  span(position: number): { start: number; stop: number } {
    const segment = this.index(position);
    return this.#hasTable(segment) ? this.tables.segment(segment) : this.tables.index.guessSpan(segment);
  }

  /** Throws ConfigError where every rung at a position shows more Gaussians than the budget has. */
  checkBudget(position: number): void {
    const segment = this.index(position);
    const least = this.knows(segment) ? Math.min(...this.of(segment).rungs.map(({ gaussians }) => gaussians)) : 0;
    if (least > this.budget) throw new ConfigError(`budget: expected ${least} Gaussians or more, got ${this.budget}`);
  }

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

  /** The offers at the next positions before `end`, with their loops, as far as tables are there. */
  upcoming(position: number, end: number): { offer: SegmentOffer; loop: number }[] {
    const found = [];
    for (let p = position; p < end; p++) {
      const { loop, segment } = this.place(p);
      if (!this.knows(segment)) break;
      found.push({ offer: this.of(segment), loop });
    }
    return found;
  }

  wire(paths: readonly string[]): number {
    const { tables, headerBytes } = this;
    const bytes = (path: string) => (path === ROOT_PATH ? tables.rootBytes : tables.entry(path).bytes);
    return paths.reduce((sum, path) => sum + headerBytes + bytes(path), 0);
  }
}

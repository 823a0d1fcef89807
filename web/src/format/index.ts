// The index of a package at work, where a frame, a segment or a group is: FORMAT.md, section 2. All count from 0.
import { DIGEST, PAGE } from "../generated/constants.ts";
import { Recent } from "./collections.ts";
import { locate, pagePath } from "./paths.ts";
import type { FileEntry, Page, Root } from "./types.ts";

/** Pages of the index, of which those last used stay: more than a buffer reaches over, and hours of play. */
const MOST_PAGES = 256;

export interface Entry {
  start: number;
  stop: number;
  firstSegment: number;
  segments: number;
  file: FileEntry;
}

/** A question that only a page of the index, or the table of a group, can answer that is not here. */
export class MissingTableError extends Error {
  override name = "MissingTableError";

  constructor(readonly path: string) {
    super(`${path} has not been read`);
  }
}

/** Groups (level 0) or pages of a level that follow each other, and the group, frame and segment each begins with. */
interface Block {
  level: number;
  spans: Page;
  groups: number[];
  frames: number[];
  segments: number[];
}

export type Count = "groups" | "frames" | "segments";
/** A block on the way to something, and the place in it. */
type Step = [Block, number];

export const sum = (counts: number[]) => counts.reduce((total, count) => total + count, 0);

const starts = (counts: number[], first: number) => counts.map((_, i) => first + sum(counts.slice(0, i)));

function block(spans: Page, level: number, first: Record<Count, number>): Block {
  const groups = spans.frames.map((_, place) => first.groups + place * PAGE ** level);
  const [frames, segments] = [starts(spans.frames, first.frames), starts(spans.segments, first.segments)];
  return { level, spans, groups, frames, segments };
}

const pathAt = ({ level, groups }: Block, place: number) => pagePath(level, groups[place]! / PAGE ** level + 1);

function entryAt({ spans, frames, segments }: Block, place: number): Entry {
  const start = frames[place]!;
  return {
    start,
    stop: start + spans.frames[place]!,
    firstSegment: segments[place]!,
    segments: spans.segments[place]!,
    file: { bytes: spans.bytes[place]!, sha256: spans.sha256.slice(DIGEST * place, DIGEST * (place + 1)) },
  };
}

const lastUpTo = (ascending: number[], value: number) => ascending.findLastIndex((one) => one <= value);

/** How many pages of a level an index leads to; of level 0, groups. */
export const countPages = (index: Root["index"], level: number): number =>
  Math.floor(sum(index.map((spans, k) => spans.frames.length * PAGE ** (k - level))));

/** Finds groups from the root down. Throws MissingTableError for a page not read, RangeError outside. */
export class GroupIndex {
  readonly groups: number = 0;
  readonly frames: number = 0;
  readonly segments: number = 0;
  #top: Block[] = [];
  #pages = new Recent<string, Block>(MOST_PAGES);

  constructor(index: Root["index"]) {
    for (const [level, spans] of [...index.entries()].reverse()) {
      this.#top.unshift(block(spans, level, this));
      this.groups += PAGE ** level * spans.frames.length;
      this.frames += sum(spans.frames);
      this.segments += sum(spans.segments);
    }
  }

  /** The index of the same package grown, with the pages that are read. */
  grown(index: Root["index"]): GroupIndex {
    const grown = new GroupIndex(index);
    grown.#pages = this.#pages;
    return grown;
  }

  addPage(path: string, page: Page): void {
    const [above, place] = this.#stepTo(path);
    const { start, firstSegment } = entryAt(above, place);
    const first = { groups: above.groups[place]!, frames: start, segments: firstSegment };
    this.#pages.set(path, block(page, above.level - 1, first));
  }

  hasPage(path: string): boolean {
    return this.#pages.has(path);
  }

  pageEntry(path: string): Entry {
    return entryAt(...this.#stepTo(path));
  }

  entry(group: number): Entry {
    return entryAt(...this.#leaf("groups", group));
  }

  groupAt(count: "frames" | "segments", number: number): number {
    const [{ groups }, place] = this.#leaf(count, number);
    return groups[place]!;
  }

  /** The pages that lead to a group, frame or segment, root first; each must be there when the next is asked for. */
  *pagesTo(count: Count, number: number): Generator<string> {
    for (const [above, place] of this.#descend(count, number)) if (above.level) yield pathAt(above, place);
  }

  leadsTo(segment: number): boolean {
    for (const path of this.pagesTo("segments", segment)) if (!this.#pages.has(path)) return false;
    return true;
  }

  /** Frames [start, stop) of a segment as if those of its group, or of its unread page, were of one length. */
  guessSpan(segment: number): { start: number; stop: number } {
    let found: Entry | null = null;
    for (const [above, place] of this.#descend("segments", segment)) {
      found = entryAt(above, place);
      if (above.level && !this.#pages.has(pathAt(above, place))) break;
    }
    const { start, stop, firstSegment, segments } = found!;
    const upTo = (parts: number) => start + Math.floor(((stop - start) * parts) / segments);
    return { start: upTo(segment - firstSegment), stop: upTo(segment - firstSegment + 1) };
  }

  #leaf(count: Count, number: number): Step {
    let found: Step | null = null;
    for (const step of this.#descend(count, number)) found = step;
    return found!;
  }

  #stepTo(path: string): Step {
    const [level, number] = locate(path)!.numbers as [number, number];
    for (const step of this.#descend("groups", (number - 1) * PAGE ** level)) if (step[0].level === level) return step;
    throw new RangeError(`${path}: no such page`);
  }

  /** The blocks that lead to a group, frame or segment, and the places in them; the first is of the root. */
  *#descend(count: Count, number: number): Generator<Step> {
    const total = this[count];
    if (!(number >= 0 && number < total)) throw new RangeError(`${count}: expected 0 to ${total - 1}, got ${number}`);
    let at = this.#top.find((top) => lastUpTo(top[count], number) >= 0)!;
    for (;;) {
      const place = lastUpTo(at[count], number);
      yield [at, place];
      if (!at.level) return;
      const path = pathAt(at, place);
      const page = this.#pages.get(path);
      if (!page) throw new MissingTableError(path);
      at = page;
    }
  }
}

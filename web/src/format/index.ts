// The index of a package at work, where a frame, a segment or a group is: FORMAT.md, section 2. All count from 0.
import { pagePath } from "./paths.ts";
import type { FileEntry, Page, Root } from "./types.ts";

/** Groups on a page. */
export const PAGE = 64;
/** Characters of a digest. */
const DIGEST = 32;

/** What the index says of a group. */
export interface GroupEntry {
  /** Its first frame. */
  start: number;
  stop: number;
  firstSegment: number;
  /** How many. */
  segments: number;
  /** Its table. */
  file: FileEntry;
}

/** A question that only a page of the index can answer which has not been read. */
export class MissingPageError extends Error {
  constructor(readonly page: number) {
    super(`${pagePath(page + 1)} has not been read`);
    this.name = "MissingPageError";
  }
}

/** Parts that follow each other. */
interface Block {
  spans: Page;
  /** The first frame of each. */
  frames: number[];
  /** The first segment of each. */
  segments: number[];
}

const sum = (counts: number[]) => counts.reduce((total, count) => total + count, 0);

function starts(counts: number[], first: number): number[] {
  let next = first;
  return counts.map((count) => {
    next += count;
    return next - count;
  });
}

const block = (spans: Page, frame: number, segment: number): Block => ({
  spans,
  frames: starts(spans.frames, frame),
  segments: starts(spans.segments, segment),
});

const file = (spans: Page, place: number): FileEntry => ({
  bytes: spans.bytes[place]!,
  sha256: spans.sha256.slice(DIGEST * place, DIGEST * (place + 1)),
});

/** The place of the last of ascending numbers that is at most `value`. */
function lastUpTo(ascending: number[], value: number): number {
  let low = 0;
  let high = ascending.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (ascending[middle]! <= value) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

/** Finds groups. Throws MissingPageError for what stands on a page not read, RangeError outside the sequence. */
export class GroupIndex {
  readonly pages: number;
  readonly groups: number;
  readonly frames: number;
  readonly segments: number;
  #pages: Block;
  #pagedFrames: number;
  #pagedSegments: number;
  #blocks = new Map<number, Block>();

  constructor(index: Root["index"]) {
    const { pages, groups } = index;
    this.#pages = block(pages, 0, 0);
    this.#pagedFrames = sum(pages.frames);
    this.#pagedSegments = sum(pages.segments);
    this.pages = pages.frames.length;
    this.groups = PAGE * this.pages + groups.frames.length;
    this.frames = this.#pagedFrames + sum(groups.frames);
    this.segments = this.#pagedSegments + sum(groups.segments);
    this.#blocks.set(this.pages, block(groups, this.#pagedFrames, this.#pagedSegments));
  }

  /** The index of the same package grown, with the pages that are read. */
  grown(index: Root["index"]): GroupIndex {
    const grown = new GroupIndex(index);
    for (const [number, { spans }] of this.#blocks) if (number < this.pages) grown.addPage(number, spans);
    return grown;
  }

  /** Takes in a page, checked by `checkPage`. */
  addPage(number: number, page: Page): void {
    this.#blocks.set(number, block(page, this.#pages.frames[number]!, this.#pages.segments[number]!));
  }

  hasPage(number: number): boolean {
    return number < this.pages && this.#blocks.has(number);
  }

  pageFile(number: number): FileEntry {
    this.#expect("page", number, this.pages);
    return file(this.#pages.spans, number);
  }

  entry(group: number): GroupEntry {
    this.#expect("group", group, this.groups);
    const { spans, frames, segments } = this.#block(Math.floor(group / PAGE));
    const place = group % PAGE;
    const start = frames[place]!;
    return {
      start,
      stop: start + spans.frames[place]!,
      firstSegment: segments[place]!,
      segments: spans.segments[place]!,
      file: file(spans, place),
    };
  }

  /** The group that shows a frame. */
  atFrame(frame: number): number {
    this.#expect("frame", frame, this.frames);
    const number = frame < this.#pagedFrames ? lastUpTo(this.#pages.frames, frame) : this.pages;
    return PAGE * number + lastUpTo(this.#block(number).frames, frame);
  }

  /** The group that a segment belongs to. */
  atSegment(segment: number): number {
    this.#expect("segment", segment, this.segments);
    const number = this.pageOfSegment(segment) ?? this.pages;
    return PAGE * number + lastUpTo(this.#block(number).segments, segment);
  }

  /** The page that says where a segment is; null where the root says it. */
  pageOfSegment(segment: number): number | null {
    return segment < this.#pagedSegments ? lastUpTo(this.#pages.segments, segment) : null;
  }

  /** The page that a group stands on; null where the root has it. */
  pageOfGroup(group: number): number | null {
    return group < PAGE * this.pages ? Math.floor(group / PAGE) : null;
  }

  /** Frames [start, stop) of a segment as if those of its group, or of its unread page, were of one length. */
  guessSpan(segment: number): { start: number; stop: number } {
    this.#expect("segment", segment, this.segments);
    const page = this.pageOfSegment(segment);
    const unread = page !== null && !this.#blocks.has(page);
    const { spans, frames, segments } = unread ? this.#pages : this.#block(page ?? this.pages);
    const place = lastUpTo(segments, segment);
    const frameCount = spans.frames[place]!;
    const count = spans.segments[place]!;
    const before = segment - segments[place]!;
    const first = frames[place]!;
    const upTo = (parts: number) => first + Math.floor((frameCount * parts) / count);
    return { start: upTo(before), stop: upTo(before + 1) };
  }

  #expect(what: string, number: number, count: number): void {
    if (!(number >= 0 && number < count)) throw new RangeError(`${what} ${number}: there are ${count}`);
  }

  #block(number: number): Block {
    const found = this.#blocks.get(number);
    if (!found) throw new MissingPageError(number);
    return found;
  }
}

// What a package offers a player, from numbers alone: `Offers` without files or tables. All count from 0.
import { GroupIndex } from "../../src/format/index.ts";
import {
  deltaMediaPath,
  keyframeMediaPath,
  keyframeSidecarPath,
  locate,
  pagePath,
  soundPath,
} from "../../src/format/paths.ts";
import { PAGE } from "../../src/generated/constants.ts";
import type { OfferTables } from "../../src/play/offers.ts";

export interface SegmentNumbers {
  frames: number;
  /** One a level; 0: nothing to fetch. */
  bytes: number[];
  /** dB, by level and quality. */
  psnr: number[][];
}

export interface GroupNumbers {
  /** Bytes. */
  table: number;
  /** Of a package with sound. */
  sound?: number;
  /** Gaussians, one a keyframe tier, where a test counts them. */
  rows?: number[];
  /** One a keyframe tier; 0: no rows. */
  sidecars: number[];
  /** By keyframe tier and quality. */
  pictures: number[][];
  segments: SegmentNumbers[];
  /** The group, from 1, that its keyframes are differences to. */
  base?: number;
}

export interface PackageNumbers {
  name: string;
  frame_rate: number[];
  header_bytes: number;
  root_bytes: number;
  page_bytes: number;
  qualities: string[];
  levels: { id: string; tiers: number; pruned: number }[];
  groups: GroupNumbers[];
}

const sum = (numbers: number[]) => numbers.reduce((a, b) => a + b, 0);

/** A package whose tables are all there; `grow` adds groups. */
export class NumberTables implements OfferTables {
  root!: OfferTables["root"];
  index!: GroupIndex;
  rootBytes: number;

  constructor(
    readonly numbers: PackageNumbers,
    count = numbers.groups.length,
    live = false,
  ) {
    this.rootBytes = numbers.root_bytes;
    this.show(count, live);
  }

  /** Go on with the first `count` groups. */
  grow(count: number, live: boolean): void {
    this.rootBytes = this.numbers.root_bytes + count;
    this.show(count, live);
  }

  private show(count: number, live: boolean): void {
    const { qualities, levels, frame_rate, page_bytes, groups } = this.numbers;
    const columns = (from: number, to: number) => {
      const parts = groups.slice(from, to);
      const frames = parts.map((part) => sum(part.segments.map((segment) => segment.frames)));
      const segments = parts.map((part) => part.segments.length);
      return { frames, segments, bytes: parts.map((part) => part.table), sha256: "" };
    };
    const paged = count - (count % PAGE);
    const pages = Array.from({ length: paged / PAGE }, (_, page) => columns(PAGE * page, PAGE * (page + 1)));
    const sums = { frames: pages.map((p) => sum(p.frames)), segments: pages.map((p) => sum(p.segments)) };
    const above = { ...sums, bytes: pages.map(() => page_bytes), sha256: "" };
    this.index = new GroupIndex([columns(paged, count), ...(pages.length ? [above] : [])]);
    pages.forEach((page, number) => {
      this.index.addPage(pagePath(1, number + 1), page);
    });
    this.root = {
      frame_rate,
      live,
      levels,
      tiers: groups[0].sidecars.length,
      frames: this.index.frames,
      views: { reference: "original" },
      qualities: qualities.map((id) => ({ id })),
    };
  }

  has(_group: number): boolean {
    return true;
  }

  segment(segment: number) {
    const { entry, part } = this.part(segment);
    const before = part.segments.slice(0, segment - entry.firstSegment);
    const { frames, psnr } = part.segments[segment - entry.firstSegment];
    const start = entry.start + sum(before.map((other) => other.frames));
    return { start, stop: start + frames, levels: psnr.map((numbers) => ({ psnr: numbers })) };
  }

  groupOf(segment: number): number {
    return this.index.groupAt("segments", segment);
  }

  rows(group: number): number[] {
    const { rows, sidecars } = this.numbers.groups[group];
    return rows ?? sidecars.map(() => 0);
  }

  keyframeFiles(group: number, tier: number, quality: number): string[] {
    const { sidecars, pictures } = this.numbers.groups[group];
    const files = sidecars[tier] ? [keyframeSidecarPath(tier, group + 1)] : [];
    return pictures[tier][quality] ? [...files, keyframeMediaPath(tier, quality, group + 1)] : files;
  }

  base(group: number): number | null {
    const { base } = this.numbers.groups[group];
    return base ? base - 1 : null;
  }

  soundFiles(group: number): string[] {
    return this.numbers.groups[group].sound ? [soundPath(group + 1)] : [];
  }

  deltaFiles(segment: number, level: number): string[] {
    return this.deltaBytes(segment, level) ? [deltaMediaPath(level, segment + 1)] : [];
  }

  private deltaBytes(segment: number, level: number): number {
    const { entry, part } = this.part(segment);
    return part.segments[segment - entry.firstSegment].bytes[level];
  }

  entry(path: string): { bytes: number } {
    const found = locate(path);
    if (!found) throw new Error(`${path}: no such file`);
    const number = found.numbers.at(-1)! - 1;
    if (found.what === "page") return { bytes: this.numbers.page_bytes };
    const group = this.numbers.groups[number];
    if (found.what === "group") return { bytes: group.table };
    if (found.what === "sound") return { bytes: group.sound ?? 0 };
    const [first, second] = found.numbers;
    if (found.what === "delta") return { bytes: this.deltaBytes(number, first) };
    return { bytes: found.what === "sidecar" ? group.sidecars[first] : group.pictures[first][second] };
  }

  private part(segment: number) {
    const group = this.groupOf(segment);
    return { entry: this.index.entry(group), part: this.numbers.groups[group] };
  }
}

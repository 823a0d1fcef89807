// The rungs of a package as people choose one: what they look like and cost on the whole.
import { groupPath } from "../format/paths.ts";
import type { Offers, SegmentOffer } from "./offers.ts";

export interface RungInfo {
  name: string;
  /** dB, mean over the time of the segments whose tables are known; null: not measured. */
  psnr: number | null;
  /** Of all that is fetched: airgs.json, tables, pictures. */
  kbps: number;
  /** Whether the budget allows it, and no other rung that it allows has more quality at no more bytes. */
  onLadder: boolean;
}

/** Sums over the segments of the groups whose tables were there when somebody asked. */
export class RungTotals {
  readonly #totals: { bytes: number; quality: number; allowed: boolean }[];
  readonly #counted = new Set<number>();
  #seconds = 0;
  #tableBytes = 0;
  #rows: RungInfo[] | null = null;

  constructor(private readonly offers: Offers) {
    this.#totals = offers.rungs.map(() => ({ bytes: 0, quality: 0, allowed: true }));
  }

  read(): RungInfo[] {
    const { index } = this.offers.tables;
    for (let group = 0; group < index.groups; group++) {
      if (this.#counted.has(group) || !this.offers.tables.has(group)) continue;
      const { firstSegment, segments } = index.entry(group);
      if (!this.offers.knows(firstSegment)) continue;
      this.#counted.add(group);
      this.#rows = null;
      this.#tableBytes += this.offers.tables.entry(groupPath(group + 1)).bytes;
      for (let s = firstSegment; s < firstSegment + segments; s++) this.#add(this.offers.of(s));
    }
    this.#rows ??= this.#list();
    return this.#rows;
  }

  #list(): RungInfo[] {
    const { measured, names, durationS, tables } = this.offers;
    const seconds = this.#seconds;
    const shared = this.#tableBytes + (tables.rootBytes * seconds) / durationS;
    const rows = this.#totals.map(({ bytes, quality, allowed }, rung) => ({
      name: names[rung],
      psnr: measured && seconds > 0 ? quality / seconds : null,
      kbps: seconds > 0 ? (8 * (bytes + shared)) / seconds / 1000 : 0,
      onLadder: allowed,
    }));
    const allowed = rows.filter(({ onLadder }) => onLadder);
    return rows.map((row) => ({ ...row, onLadder: row.onLadder && !allowed.some((other) => beats(other, row)) }));
  }

  #add({ rungs, group, seconds, startsGroup }: SegmentOffer): void {
    this.#seconds += seconds;
    rungs.forEach(({ gaussians, psnr, keyframes, deltaBytes }, rung) => {
      const own = startsGroup ? keyframes.filter((keyframe) => keyframe.group === group) : []; // what it reuses was there before
      const total = this.#totals[rung];
      total.allowed &&= gaussians <= this.offers.budget;
      total.bytes += own.reduce((sum, { bytes }) => sum + bytes, deltaBytes);
      total.quality += seconds * psnr;
    });
  }
}

/** More quality at no more bytes, or the same at fewer; without qualities none beats another. */
function beats(a: { psnr: number | null; kbps: number }, b: { psnr: number | null; kbps: number }): boolean {
  if (a.psnr === null || b.psnr === null) return false;
  return a.kbps <= b.kbps && a.psnr >= b.psnr && (a.kbps < b.kbps || a.psnr > b.psnr);
}

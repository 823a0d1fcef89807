// The rungs of a package as people choose one: what they look like and cost on the whole.
import { type Catalogue, NONE } from "./catalogue.ts";

/** A rung of the whole package, for people who choose one. */
export interface RungInfo {
  /** Such as Q1+L2. */
  name: string;
  /** dB, mean over the time of the segments whose tables are known; null: not measured. */
  psnr: number | null;
  /** Mean over the same segments, headers included. */
  kbps: number;
  /** Whether the budget allows it, and no other rung that it allows has more quality at no more bytes. */
  onLadder: boolean;
}

/** Sums over the segments of the groups whose tables were there when somebody asked. */
export class RungTotals {
  readonly #totals: { bytes: number; quality: number }[];
  readonly #counted = new Set<number>();
  /** Whether the budget has the Gaussians of a rung in all groups so far. */
  readonly #allowed: boolean[];
  #seconds = 0;
  #rows: RungInfo[] | null = null;

  constructor(private readonly catalogue: Catalogue) {
    this.#totals = catalogue.rungs.map(() => ({ bytes: 0, quality: 0 }));
    this.#allowed = catalogue.rungs.map(() => true);
  }

  /** One a rung. */
  read(): RungInfo[] {
    const { tables } = this.catalogue;
    for (let group = 0; group < tables.index.groups; group++) {
      if (this.#counted.has(group) || !tables.has(group)) continue;
      const { firstSegment, segments } = tables.index.entry(group);
      if (!this.catalogue.knows(firstSegment)) continue;
      this.#counted.add(group);
      this.#rows = null;
      for (let s = firstSegment; s < firstSegment + segments; s++) this.#add(s);
    }
    this.#rows ??= this.#list();
    return this.#rows;
  }

  #list(): RungInfo[] {
    const { measured, names } = this.catalogue;
    const seconds = this.#seconds;
    const rows = this.#totals.map(({ bytes, quality }, rung) => ({
      name: names[rung],
      psnr: measured && seconds > 0 ? quality / seconds : null,
      kbps: seconds > 0 ? (8 * bytes) / seconds / 1000 : 0,
    }));
    const allowed = rows.filter((_, rung) => this.#allowed[rung]);
    return rows.map((row, rung) => {
      return { ...row, onLadder: this.#allowed[rung] && !allowed.some((other) => beats(other, row)) };
    });
  }

  #add(s: number): void {
    const c = this.catalogue;
    const seconds = c.seconds(s);
    this.#seconds += seconds;
    const kept = new Set(Array.from({ length: c.unit(c.tables.root.qualities.length, 0) }, (_, unit) => unit));
    const sizes = c.sizes(s, NONE, kept); // what is kept was there before
    const states = c.stateBytes(s);
    const quality = c.quality(s);
    const begins = c.startsGroup(s);
    const rows = c.rows(s);
    c.rungs.forEach(([, level], rung) => {
      this.#allowed[rung] &&= rows[rung] <= c.budget;
      this.#totals[rung].bytes += begins ? sizes[rung] : states[level];
      this.#totals[rung].quality += seconds * quality[rung];
    });
  }
}

/** Whether a rung has more quality at no more bytes, or the same at fewer; without qualities none beats another. */
function beats(a: { psnr: number | null; kbps: number }, b: { psnr: number | null; kbps: number }): boolean {
  if (a.psnr === null || b.psnr === null) return false;
  return a.kbps <= b.kbps && a.psnr >= b.psnr && (a.kbps < b.kbps || a.psnr > b.psnr);
}

// Which levels are offered: those that this device keeps up with, unless the viewer has chosen a rung.
import type { Offers } from "./offers.ts";
import type { Clip } from "./pipeline.ts";
import type { Playout } from "./playout.ts";
import { DropRule } from "./policies/drops.ts";
import type { PlayerStats, Statistics } from "./statistics.ts";

interface HeldParts {
  offers: Offers;
  playout: Playout;
  statistics: Statistics;
  wishes: { readonly quality: string };
}

/** Asks the rule of dropped frames, and has levels offered as it says. */
export class Held {
  readonly #rule: DropRule;
  /** Frames that were dropped before the last one that was drawn. */
  #before: ReturnType<Statistics["dropped"]>;

  constructor(private readonly parts: HeldParts) {
    this.#rule = new DropRule(parts.offers.tables.root.levels.map(({ tiers }) => tiers));
    this.#before = parts.statistics.dropped(parts.playout);
  }

  /** Pictures are of another size, or play has another speed. */
  restart(): void {
    this.#rule.restart();
  }

  /** A new frame was drawn. True: what is buffered is too slow. */
  drawn({ rung }: Clip): boolean {
    const { offers, playout, statistics, wishes } = this.parts;
    const [before, all] = [this.#before, statistics.dropped(playout)];
    this.#before = all;
    if (wishes.quality !== "auto") return false;
    const dropped = { decoder: all.decoder - before.decoder, display: all.display - before.display };
    const was = offers.finest;
    if (this.#rule.add({ level: offers.rungs[rung][1], rate: offers.fps * playout.speed, dropped })) this.offer();
    return offers.finest > was;
  }

  offer(): void {
    const { offers, wishes } = this.parts;
    offers.finest = wishes.quality === "auto" ? this.#rule.finest : 0;
  }

  get told(): PlayerStats["held"] {
    const { finest: rung } = this.parts.offers; // the one with the finest keys
    const { cause: by } = this.#rule;
    return rung && by ? { rung, by } : null;
  }
}

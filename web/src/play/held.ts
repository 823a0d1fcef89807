// Which levels are offered: those that this device keeps up with, unless the viewer has chosen a rung.
import type { Offers } from "./offers.ts";
import type { Clip } from "./pipeline.ts";
import type { Playout } from "./playout.ts";
import { DropRule } from "./policies/drops.ts";
import type { PlayerStats, Statistics } from "./statistics.ts";

/** Asks the rule of dropped frames, and has levels offered as it says. */
export class Held {
  readonly #rule: DropRule;
  /** Frames that were dropped before the last one that was drawn. */
  #before: ReturnType<Statistics["dropped"]>;

  constructor(
    private readonly offers: Offers,
    private readonly playout: Playout,
    private readonly statistics: Statistics,
    private readonly wishes: { readonly quality: string },
  ) {
    this.#rule = new DropRule(offers.tables.root.levels.map(({ tiers }) => tiers));
    this.#before = statistics.dropped(playout);
  }

  /** Pictures are of another size, or play has another speed. */
  restart(): void {
    this.#rule.restart();
  }

  /** A new frame was drawn. True: what is buffered is too slow. */
  drawn({ rung }: Clip): boolean {
    const { offers, playout, statistics } = this;
    const [before, all] = [this.#before, statistics.dropped(playout)];
    this.#before = all;
    if (this.wishes.quality !== "auto") return false;
    const dropped = { decoder: all.decoder - before.decoder, display: all.display - before.display };
    const was = offers.finest;
    if (this.#rule.add({ level: offers.rungs[rung][1], rate: offers.fps * playout.schedule.speed, dropped }))
      this.offer();
    return offers.finest > was;
  }

  offer(): void {
    this.offers.finest = this.wishes.quality === "auto" ? this.#rule.finest : 0;
  }

  get told(): PlayerStats["held"] {
    const { finest: rung } = this.offers; // the one with the finest keys
    const { cause: by } = this.#rule;
    return rung && by ? { rung, by } : null;
  }
}

// Pictures that are not there when they are due: the schedule waits for them, and the time that this takes is counted as
// frames that were dropped. A stall is something else: the wait for bytes.
import type { Offers } from "./offers.ts";
import type { Clip } from "./pipeline.ts";
import type { Playout } from "./playout.ts";
import { DropRule } from "./policies/drops.ts";
import type { Lack } from "./schedule.ts";
import type { PlayerStats, Statistics } from "./statistics.ts";

/** Of a longer time without a chance to show something, the schedule waits for the rest, seconds. */
const LONGEST_TICK_S = 0.25;

/** Sound goes on so long without a picture; once it had to stop, so long all must be well, seconds. */
const PATIENCE_S = 0.2;
const CALM_S = 0.5;

/** Holds a schedule while a picture lacks. Moments are seconds of its clock. */
export class Waits {
  #tickedS = Number.POSITIVE_INFINITY;
  #lackedS = Number.POSITIVE_INFINITY;
  #stoppedS = Number.NEGATIVE_INFINITY;

  /** `sounds`: whether sound is heard, which a lack of pictures would break off. */
  constructor(
    private readonly playout: Playout,
    private readonly sounds = () => false,
  ) {}

  /** The page has the chance to show something, whenever the display takes it. */
  tick(nowS: number): void {
    const sinceS = this.#tickedS + LONGEST_TICK_S;
    if (sinceS < nowS && !this.playout.waits(sinceS) && !this.sounds()) this.playout.hold(sinceS, "display", true);
    this.#tickedS = nowS;
  }

  calm(nowS: number): boolean {
    return nowS - this.#stoppedS > CALM_S;
  }

  /** What the frame that is due lacks from now on; null: nothing. */
  lack(nowS: number, what: Lack | null): void {
    this.#lackedS = what && what !== "start" ? Math.min(this.#lackedS, nowS) : Number.POSITIVE_INFINITY;
    const isLong = nowS - this.#lackedS > PATIENCE_S;
    if (isLong) this.#stoppedS = nowS;
    if (what && (what === "start" || isLong || !this.sounds())) this.playout.hold(nowS, what, true);
    for (const other of ["decoder", "display", "start"] as const) {
      if (other !== what) this.playout.hold(nowS, other, false);
    }
  }
}

export class Held {
  readonly #rule: DropRule;
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
    const { finest: rung } = this.offers; // the one with the finest keyframes
    const { cause: by } = this.#rule;
    return rung && by ? { rung, by } : null;
  }
}

// The time of a schedule: seconds of media and of stalls, one after the other.

/** Why a frame whose bytes are there is not on the screen; "start": playing begins there, and nobody misses frames. */
export type Lack = "decoder" | "display" | "start";

/** Why a schedule stands still: the viewer paused it, nobody sees the page, or a picture lacks. */
export type Hold = "pause" | "hidden" | Lack;
/** With another reason beside them, nobody misses pictures. */
const EXCUSES: readonly Hold[] = ["pause", "hidden", "start"];

/** Maps moments of a clock to places of a schedule. `speed` seconds pass a second, and none while it is held. */
export class Schedule {
  /** Seconds of media that would have passed meanwhile, up to the last change. */
  readonly missedS = { decoder: 0, display: 0 };
  speed = 1;
  private readonly holds = new Set<Hold>();
  private clockS = 0;
  private placeS = 0; // at clockS

  get held(): boolean {
    return this.holds.size > 0;
  }

  at(nowS: number): number {
    return this.held ? this.placeS : this.placeS + this.speed * Math.max(0, nowS - this.clockS);
  }

  /** When a place is reached; where the schedule is held, as if it went on at `nowS`. */
  reached(placeS: number, nowS: number): number {
    return (this.held ? nowS : this.clockS) + (placeS - this.placeS) / this.speed;
  }

  /** Stand still for a reason, beside others, or no longer for this one. False: it is so already. */
  hold(nowS: number, why: Hold, held: boolean): boolean {
    if (this.holds.has(why) === held) return false;
    this.move(nowS);
    if (held) this.holds.add(why);
    else this.holds.delete(why);
    return true;
  }

  setSpeed(nowS: number, speed: number): void {
    this.move(nowS);
    this.speed = speed;
  }

  /** Be so many seconds further on; where they are negative, stand still for them. */
  shift(nowS: number, seconds: number): void {
    if (this.held) return;
    this.move(nowS);
    this.placeS += Math.max(0, seconds);
    this.clockS -= Math.min(0, seconds) / this.speed;
  }

  /** Go on to a moment. One before the last change is that change: what was shown is not due again. */
  private move(nowS: number): void {
    const thenS = Math.max(nowS, this.clockS);
    if (this.held && !EXCUSES.some((why) => this.holds.has(why))) {
      this.missedS[this.holds.has("decoder") ? "decoder" : "display"] += this.speed * (thenS - this.clockS);
    }
    this.placeS = this.at(thenS);
    this.clockS = thenS;
  }
}

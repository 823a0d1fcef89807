// The time of a schedule: seconds of media and of stalls, one after the other.

/** Why a schedule stands still: the viewer paused it, nobody sees the page, or the display waits for pictures. */
export type Hold = "pause" | "hidden" | "display";

/** Maps moments of a clock to places of a schedule. `speed` seconds pass a second, and none while it is held. */
export class Schedule {
  /** Seconds that the display alone held it, up to the last change. */
  displayS = 0;
  private pace = 1;
  private readonly holds = new Set<Hold>();
  private clockS = 0;
  private placeS = 0; // at clockS

  get held(): boolean {
    return this.holds.size > 0;
  }

  /** Seconds of the schedule a second, where it is not held. */
  get speed(): number {
    return this.pace;
  }

  /** The place that is reached at a moment, as things are now. */
  at(nowS: number): number {
    return this.held ? this.placeS : this.placeS + this.pace * (nowS - this.clockS);
  }

  /** When a place is reached; where the schedule is held, as if it went on at `nowS`. */
  reached(placeS: number, nowS: number): number {
    return (this.held ? nowS : this.clockS) + (placeS - this.placeS) / this.pace;
  }

  /** Stand still for a reason, beside others. False: it did for this one. */
  hold(why: Hold, nowS: number): boolean {
    if (this.holds.has(why)) return false;
    this.move(nowS);
    this.holds.add(why);
    return true;
  }

  /** Go on, unless there is another reason. False: it did not stand still for this one. */
  release(why: Hold, nowS: number): boolean {
    if (!this.holds.has(why)) return false;
    this.move(nowS);
    this.holds.delete(why);
    return true;
  }

  setSpeed(nowS: number, speed: number): void {
    this.move(nowS);
    this.pace = speed;
  }

  /** Go on to a moment. One before the last change is that change: what was shown is not due again. */
  private move(nowS: number): void {
    const thenS = Math.max(nowS, this.clockS);
    if (this.holds.size === 1 && this.holds.has("display")) this.displayS += thenS - this.clockS;
    this.placeS = this.at(thenS);
    this.clockS = thenS;
  }
}

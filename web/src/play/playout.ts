// What is on the screen and what waits to be: starts and stalls of segments, and nothing about where they come from.
//
// The timeline holds segments of a session by position. Those before `firstWaiting` have a place in the schedule; the
// others wait until enough media has arrived. Moments (`…S`) are seconds of the downloader's clock, places (`…At`)
// those of the schedule, which stands still while it is held and passes at the speed of playing: see schedule.ts.
import { SESSION } from "../generated/constants.ts";
import { ConfigError, type Offers } from "./offers.ts";
import { type Hold, Schedule } from "./schedule.ts";

type Rules = typeof SESSION;

/** The rules of airgs_codec.play.settings, which says what each is. */
export type SessionSettings = { [Name in keyof Rules]: Rules[Name] extends number ? number : boolean };

/** Settings with defaults for what is not given. Throws ConfigError for a buffer that cannot work. */
export function sessionSettings(given: Partial<SessionSettings> = {}): SessionSettings {
  const settings = { ...SESSION, ...given };
  const { bufferS } = settings;
  if (!(bufferS > 0 && bufferS < Infinity)) throw new ConfigError(`buffer: expected more than 0 s, got ${bufferS}`);
  return settings;
}

/** Seconds for which segments that were shown stay in the timeline. */
const PAST_S = 60;
/** A frame begins so much of a frame early, since seconds that stand for whole frames are rounded. */
export const EARLY = 1e-6;

export interface Slot {
  readonly position: number;
  rung: number | null;
  readonly seconds: number;
  readonly frames: number;
  readonly readyS: number;
  readonly readyAt: number;
  /** Of its display; Infinity while it waits. */
  startAt: number;
  stallS: number;
  /** Its decoding began: what it shows can no longer change. */
  committed: boolean;
}

/** The timeline of a session up to the position `end`, so far where the package grows. */
export class Playout {
  stalls = 0;
  stallS = 0;
  readonly schedule = new Schedule();
  /** The timeline: segments that are shown, scheduled or wait, and those of the last minute, in order. */
  slots: Slot[] = [];
  private firstWaiting = 0;
  private firstUnseen = 0; // of the timeline: those before it were given by `started`
  private skipS = 0;
  private finished = false;
  private readonly listeners = new Set<() => void>();

  constructor(
    readonly offers: Offers,
    readonly settings: SessionSettings,
    public end: number,
  ) {}

  get last(): Slot | null {
    return this.slots.at(-1) ?? null;
  }

  /** Frames whose time passed while the schedule waited for the decoder or the display. */
  get missed(): { decoder: number; display: number } {
    const { decoder, display } = this.schedule.missedS;
    const frames = (seconds: number) => Math.floor(seconds * this.offers.fps + EARLY);
    return { decoder: frames(decoder), display: frames(display) };
  }

  onChange(listener: () => void): () => void {
    this.listeners.add(listener);
    return () => this.listeners.delete(listener);
  }

  /** The schedule stands still for a reason from now on, or no longer for this one. */
  hold(nowS: number, why: Hold, held: boolean): void {
    if (this.schedule.hold(nowS, why, held)) this.changed();
  }

  /** So many seconds of media a second, more than 0, from now on. */
  setSpeed(nowS: number, speed: number): void {
    this.schedule.setSpeed(nowS, speed);
    this.changed();
  }

  /** Drop the segments from a position on: another session fetches them, or others, again. */
  truncate(position: number): void {
    this.slots = this.slots.filter((slot) => slot.position < position);
    this.firstWaiting = Math.min(this.firstWaiting, this.slots.length);
    this.firstUnseen = Math.min(this.firstUnseen, this.slots.length);
    this.finished = false;
    this.changed();
  }

  /** Drop all segments: playing begins anew with what is enqueued next, so many seconds of media into it. */
  restart(skipS = 0): void {
    this.skipS = skipS;
    this.truncate(-Infinity);
  }

  /** Frames of a segment that nobody will see, as playing begins after them. */
  skipped(slot: Slot): number {
    return slot === this.slots[0] ? Math.min(slot.frames - 1, Math.floor(this.skipS * this.offers.fps + EARLY)) : 0;
  }

  commit(position: number): void {
    const slot = this.slots.find((one) => one.position === position);
    if (slot) slot.committed = true;
  }

  /** The first position whose segment can still be dropped without a trace, begun and committed ones aside. */
  firstFree(nowS: number): number | null {
    const place = this.schedule.at(nowS);
    const last = this.slots.findLast((slot) => slot.committed || slot.startAt <= place);
    return last ? last.position + 1 : (this.slots[0]?.position ?? null);
  }

  /** The segment on the screen and the number of its frame; where playing waits, the last one. Null: nothing yet. */
  at(nowS: number): { slot: Slot; frame: number } | null {
    const place = this.schedule.at(nowS);
    const slot = this.slots.findLast((one) => one.startAt <= place);
    if (!slot) return null;
    const frame = Math.floor((place - slot.startAt) * this.offers.fps + EARLY);
    return { slot, frame: Math.min(slot.frames - 1, Math.max(this.skipped(slot), frame)) };
  }

  /** Whether there is nothing to go on with: before playing begins, in a stall, and after the end. */
  waits(nowS: number): boolean {
    return this.schedule.at(nowS) >= this.scheduledEndAt;
  }

  done(nowS: number): boolean {
    const whole = this.finished || (!this.offers.live && (this.last?.position ?? -Infinity) >= this.end - 1);
    return whole && this.waits(nowS) && this.firstWaiting === this.slots.length;
  }

  bufferS(nowS: number): number {
    return Math.max(0, this.dueAt(nowS) - this.schedule.at(nowS));
  }

  /** Lists what is at hand from the segment on the screen on, in seconds of the sequence, with its rungs. */
  buffered(nowS: number): { start: number; stop: number; rung: number }[] {
    const ranges: { start: number; stop: number; rung: number }[] = [];
    const place = this.schedule.at(nowS);
    for (const slot of this.slots) {
      if (slot.rung === null || slot.startAt + slot.seconds <= place) continue;
      const span = this.offers.span(slot.position);
      const [start, stop] = [span.start / this.offers.fps, span.stop / this.offers.fps];
      const before = ranges.at(-1);
      if (before && before.stop === start && before.rung === slot.rung) before.stop = stop;
      else ranges.push({ start, stop, rung: slot.rung });
    }
    return ranges;
  }

  /** When a segment's first frame is shown, as the schedule stands; if it is held, as if it went on now. */
  startS(slot: Slot, nowS: number): number {
    return this.schedule.reached(slot.startAt, nowS);
  }

  /** The place where the next segment is due; where playing waits, as if it went on now. */
  dueAt(nowS: number): number {
    const waiting = this.waitingS();
    const resumes = waiting || !this.firstWaiting ? this.schedule.at(nowS) : -Infinity;
    return Math.max(this.scheduledEndAt, resumes) + waiting;
  }

  /** When a segment that is due at a place must have arrived to be shown without a stall. */
  deadlineS(dueAt: number, nowS: number): number {
    return this.schedule.reached(dueAt, nowS) - this.settings.decodeFrameS;
  }

  /** Resume if playing waits for more media although the buffer is too full for the segment at a position. */
  makeRoom(position: number): void {
    if (this.blocking(position)?.slot.startAt === Infinity) this.resume();
  }

  /** Earliest request time at which the segment fits the buffer; −Infinity if it fits now. */
  earliestRequestS(position: number, nowS: number): number {
    const blocking = this.blocking(position);
    if (!blocking) return -Infinity;
    const place = blocking.slot.startAt + blocking.restS;
    return this.schedule.held && place > this.schedule.at(nowS) ? Infinity : this.schedule.reached(place, nowS);
  }

  /** Append a segment that arrived, or is lost (rung null); playing begins or goes on when there is enough. */
  enqueue(position: number, rung: number | null, arrivedS: number): void {
    const readyS = arrivedS + (rung === null ? 0 : this.settings.decodeFrameS);
    const { start, stop } = this.offers.span(position);
    const [frames, seconds] = [stop - start, (stop - start) / this.offers.fps];
    const arrived = { position, rung, seconds, frames, readyS, readyAt: this.schedule.at(readyS) };
    const slot: Slot = { ...arrived, startAt: Infinity, stallS: 0, committed: false };
    this.slots.push(slot);
    this.finished = false;
    this.place(slot);
    this.trim(arrivedS);
    this.changed();
  }

  finish(nowS: number): void {
    this.finished = true;
    if (this.firstWaiting < this.slots.length) this.resume(this.schedule.at(nowS));
    this.changed();
  }

  /** Segments that `started` did not give yet, but for lost and committed ones: what they show can change. */
  pending(): Slot[] {
    return this.slots.slice(this.firstUnseen).filter((slot) => slot.rung !== null && !slot.committed);
  }

  replace(slot: Slot, rung: number): void {
    slot.rung = rung;
    this.changed();
  }

  /** A segment turns out to be of no use: the picture before it stands for its time. */
  lose(position: number): void {
    const slot = this.slots.find((one) => one.position === position);
    if (slot) slot.rung = null;
    this.changed();
  }

  /** Segments that began before a moment (null: have a place) and were not given yet: they stay as they are. */
  started(beforeS: number | null): Slot[] {
    const before = beforeS === null ? Infinity : this.schedule.at(beforeS);
    const first = this.firstUnseen;
    while (this.firstUnseen < this.firstWaiting && this.slots[this.firstUnseen].startAt < before) this.firstUnseen++;
    return this.slots.slice(first, this.firstUnseen);
  }

  /** End of the last segment that has a place; −Infinity before playing begins. */
  private get scheduledEndAt(): number {
    if (!this.firstWaiting) return -Infinity;
    const slot = this.slots[this.firstWaiting - 1];
    return slot.startAt + slot.seconds;
  }

  private waitingS(): number {
    const waiting = this.slots.slice(this.firstWaiting);
    const sum = waiting.reduce((seconds, slot) => seconds + slot.seconds, 0);
    return waiting.length && !this.firstWaiting ? sum - this.skipS : sum;
  }

  /** The latest segment that must have begun for another to fit the buffer, and seconds to be shown of it. */
  private blocking(position: number): { slot: Slot; restS: number } | null {
    const { start, stop } = this.offers.span(position);
    let ahead = (stop - start) / this.offers.fps;
    const most = this.settings.bufferS;
    for (let i = this.slots.length - 1; i >= 0; i--) {
      const slot = this.slots[i];
      if (ahead + slot.seconds > most) return { slot, restS: slot.seconds - Math.max(0, most - ahead) };
      ahead += slot.seconds;
    }
    return null;
  }

  private place(slot: Slot): void {
    if (this.slots.length - this.firstWaiting === 1 && slot.readyAt <= this.scheduledEndAt) {
      slot.startAt = this.scheduledEndAt;
      this.firstWaiting++;
      return;
    }
    const wanted = this.firstWaiting ? this.settings.resumeS : this.settings.startupS;
    const isLast = slot.position === this.end - 1 && !this.offers.live;
    if (isLast || this.waitingS() >= wanted) this.resume();
  }

  /** Show what waits, one segment after another, from the place where all of it is ready. */
  private resume(earliestAt = -Infinity): void {
    const waiting = this.slots.slice(this.firstWaiting);
    const dueAt = this.scheduledEndAt;
    let at = Math.max(dueAt, earliestAt, ...waiting.map((slot) => slot.readyAt));
    if (this.firstWaiting) {
      const stallS = (at - dueAt) / this.schedule.speed;
      waiting[0].stallS = stallS;
      this.stallS += stallS;
      if (stallS > 0) this.stalls++;
    } else at -= this.skipS;
    for (const slot of waiting) {
      slot.startAt = at;
      at += slot.seconds;
    }
    this.firstWaiting = this.slots.length;
  }

  private trim(nowS: number): void {
    const longAgo = this.schedule.at(nowS) - PAST_S;
    const past = this.slots.findIndex((slot) => slot.startAt + slot.seconds >= longAgo);
    const count = Math.min(past, this.firstUnseen, this.firstWaiting - 1);
    if (count <= 0) return;
    this.slots.splice(0, count);
    this.skipS = 0;
    this.firstWaiting -= count;
    this.firstUnseen -= count;
  }

  private changed(): void {
    for (const listener of this.listeners) listener();
  }
}

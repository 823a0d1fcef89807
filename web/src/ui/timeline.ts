// The time line: where we are, what is there in which quality, and a way to go elsewhere.

import { stripes } from "./colours.ts";
import type { Desk, Part } from "./desk.ts";
import { make, write } from "./dom.ts";
import { clock, rungTitle, spoken } from "./words.ts";

const STEP_S = 5;
const PAGE_SHARE = 0.1;
/** Milliseconds between seeks while a pointer is dragged: each one fetches something. */
const SEEK_MS = 150;

export class Timeline {
  readonly node: HTMLElement;
  readonly #ahead = make("div", { class: "ahead" });
  readonly #played = make("div", { class: "played" });
  readonly #thumb = make("div", { class: "thumb" });
  readonly #tip = make("div", { class: "tip", "aria-hidden": "true" });
  /** What was on the screen, in which rung: a player may forget it. */
  #seen: Part[] = [];
  #dragged: number | null = null;
  #sought = 0;
  #painted = "";

  constructor(readonly desk: Desk) {
    const track = make("div", { class: "track" }, this.#ahead, this.#played);
    this.node = make(
      "div",
      { class: "timeline", part: "timeline", role: "slider", tabindex: 0, "aria-label": "Seek", "aria-valuemin": 0 },
      track,
      this.#thumb,
      this.#tip,
    );
    const on = { signal: desk.signal };
    this.node.addEventListener("pointerdown", (event) => this.#down(event), on);
    this.node.addEventListener("pointermove", (event) => this.#move(event), on);
    this.node.addEventListener("pointerup", (event) => this.#up(event), on);
    this.node.addEventListener("pointercancel", () => this.#end(), on);
    this.node.addEventListener("keydown", (event) => this.#key(event), on);
  }

  get scrubbing(): boolean {
    return this.#dragged !== null;
  }

  get time(): number {
    return this.#dragged ?? this.desk.player.currentTime;
  }

  update(): void {
    const { player } = this.desk;
    const total = player.duration;
    const time = Math.min(this.time, total);
    const share = total > 0 ? time / total : 0;
    this.node.style.setProperty("--at", share.toFixed(5));
    this.node.ariaValueMax = total.toFixed(1);
    this.node.ariaValueNow = time.toFixed(1);
    const text = `${spoken(time)} of ${spoken(total)}`;
    if (this.node.ariaValueText !== text) this.node.ariaValueText = text;
    if (player.rung !== null) this.#seen = seen(this.#seen, player.currentTime, player.rung);
    this.#paint(total);
  }

  #paint(total: number): void {
    const { player, colours } = this.desk;
    const parts = [...this.#seen, ...player.buffered].sort((a, b) => a.start - b.start);
    const coloured = parts.map((part) => ({ ...part, colour: colours[part.rung] ?? "#fff8" }));
    const picture = stripes(coloured, total);
    if (picture === this.#painted) return;
    this.#painted = picture;
    this.#ahead.style.backgroundImage = picture;
    this.#played.style.backgroundImage = picture;
  }

  #at(event: PointerEvent): number {
    const { left, width } = this.node.getBoundingClientRect();
    const share = Math.max(0, Math.min(1, (event.clientX - left) / (width || 1)));
    return share * this.desk.player.duration;
  }

  #down(event: PointerEvent): void {
    if (event.button !== 0 || !this.desk.ready) return;
    this.node.setPointerCapture(event.pointerId);
    this.#drag(this.#at(event), event.timeStamp);
  }

  #drag(time: number, now: number): void {
    this.#dragged = time;
    if (now - this.#sought > SEEK_MS) {
      this.#sought = now;
      this.desk.seek(time);
    }
    this.desk.wake();
  }

  #move(event: PointerEvent): void {
    const time = this.#at(event);
    const { player } = this.desk;
    const there = player.buffered.find((part) => part.start <= time && time < part.stop);
    const rung = there && this.desk.rungs[there.rung];
    this.#tip.style.setProperty("--tip", String(player.duration > 0 ? time / player.duration : 0));
    write(this.#tip, clock(time, player.duration) + (rung ? ` · ${rungTitle(rung)}` : ""));
    if (this.#dragged !== null) this.#drag(time, event.timeStamp);
  }

  #up(event: PointerEvent): void {
    if (this.#dragged === null) return;
    this.desk.seek(this.#at(event));
    this.#end();
  }

  #end(): void {
    this.#dragged = null;
    this.desk.wake();
  }

  #key(event: KeyboardEvent): void {
    const { duration } = this.desk.player;
    const skips: Readonly<Record<string, number>> = {
      ArrowLeft: -STEP_S,
      ArrowDown: -STEP_S,
      ArrowRight: STEP_S,
      ArrowUp: STEP_S,
      PageDown: -PAGE_SHARE * duration,
      PageUp: PAGE_SHARE * duration,
      Home: -duration,
      End: duration,
    };
    const skip = skips[event.key];
    if (skip === undefined || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    this.desk.skip(skip);
  }
}

/** A longer way between two pictures is a jump: nothing was seen in between. */
const JUMP_S = 1;

/** The parts that were seen, in the order in which they were, with a picture at `time` in place of what was there. */
export function seen(parts: readonly Part[], time: number, rung: number): Part[] {
  const last = parts.at(-1);
  const goesOn = last && last.rung === rung && time >= last.stop && time - last.stop < JUMP_S;
  const grown = { start: goesOn ? last.start : time, stop: time, rung };
  const others = (goesOn ? parts.slice(0, -1) : parts).flatMap((part) => {
    if (part.start > grown.stop || part.stop <= grown.start) return [part];
    const rest = [
      { ...part, stop: Math.min(part.stop, grown.start) },
      { ...part, start: Math.max(part.start, grown.stop) },
    ];
    return rest.filter((one) => one.stop > one.start);
  });
  return [...others, grown];
}

// A hand or a key on the time line: it goes there, and a tip says what is there.
import type { Desk } from "./desk.ts";
import { make, write } from "./dom.ts";
import type { Timeline } from "./timeline.ts";
import { clock, rungTitle } from "./words.ts";

const STEP_S = 5;
const PAGE_SHARE = 0.1;
/** Milliseconds between seeks while a pointer is dragged: each one fetches something. */
const SEEK_MS = 150;

export class Scrub {
  readonly #tip = make("div", { class: "tip", "aria-hidden": "true" });
  #sought = 0;

  constructor(
    readonly desk: Desk,
    readonly timeline: Timeline,
  ) {
    const { node } = timeline;
    node.append(this.#tip);
    const on = { signal: desk.signal };
    node.addEventListener("pointerdown", (event) => this.#down(event), on);
    node.addEventListener("pointermove", (event) => this.#move(event), on);
    node.addEventListener("pointerup", (event) => this.#up(event), on);
    node.addEventListener("pointercancel", () => this.#end(), on);
    node.addEventListener("keydown", (event) => this.#key(event), on);
  }

  #at(event: PointerEvent): number {
    const { left, width } = this.timeline.node.getBoundingClientRect();
    const share = Math.max(0, Math.min(1, (event.clientX - left) / (width || 1)));
    return share * this.desk.player.duration;
  }

  #down(event: PointerEvent): void {
    if (event.button !== 0 || !this.desk.ready) return;
    this.timeline.node.setPointerCapture(event.pointerId);
    this.#drag(this.#at(event), event.timeStamp);
  }

  #drag(time: number, now: number): void {
    this.timeline.dragged = time;
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
    write(this.#tip, clock(time, player.duration) + (rung ? ` · ${rungTitle(this.desk, rung)}` : ""));
    if (this.timeline.dragged !== null) this.#drag(time, event.timeStamp);
  }

  #up(event: PointerEvent): void {
    if (this.timeline.dragged === null) return;
    this.desk.seek(this.#at(event));
    this.#end();
  }

  #end(): void {
    this.timeline.dragged = null;
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

// The time line: where we are, and what is there in which quality. `Scrub` is the way to go elsewhere.
import type { Desk, Part } from "./desk.ts";
import { make } from "./dom.ts";
import { spoken, stripes } from "./words.ts";

export class Timeline {
  readonly node: HTMLElement;
  readonly #ahead = make("div", { class: "ahead" });
  readonly #played = make("div", { class: "played" });
  readonly #thumb = make("div", { class: "thumb" });
  #seen: Part[] = [];
  /** The time that a hand drags it to, seconds; null: none does. */
  dragged: number | null = null;
  #painted = "";

  constructor(readonly desk: Desk) {
    const track = make("div", { class: "track" }, this.#ahead, this.#played);
    const attributes = { role: "slider", tabindex: 0, "aria-label": "Seek", "aria-valuemin": 0 };
    this.node = make("div", { class: "timeline", part: "timeline", ...attributes }, track, this.#thumb);
  }

  get scrubbing(): boolean {
    return this.dragged !== null;
  }

  get time(): number {
    return this.dragged ?? this.desk.player.currentTime;
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

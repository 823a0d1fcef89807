// Two rungs beside each other: a second player on top of the first, of which only what is right of a seam is seen. It
// plays one rung, from where the first one looks, and follows its time.
import type { Problem } from "../play/playback.ts";
import type { RungInfo } from "../play/rungs.ts";
import type { Desk, PlayerLike } from "./desk.ts";
import { make, write } from "./dom.ts";
import { rungFigures, rungTitle } from "./words.ts";

/** The two are at most so far apart, frames; to catch up, the second is so many times as fast. */
const APART = 0.5;
const FASTER = 1.15;
/** Farther apart, seconds, it jumps. */
const JUMP_S = 1;
const STEP = 0.05;

export class Split {
  readonly #canvas = make("canvas", { class: "second" });
  readonly #left = make("span");
  readonly #right = make("span");
  readonly #seam = make(
    "div",
    { class: "seam", part: "seam", role: "slider", tabindex: 0, "aria-label": "Where the pictures meet", hidden: true },
    this.#left,
    this.#right,
  );
  readonly #player: PlayerLike;
  #at = 0.5;
  #open = false;

  /** `rung`: a name of the package's; `create` makes a player; `failed` is told why there will be no picture. */
  constructor(
    readonly desk: Desk,
    frame: HTMLElement,
    readonly rung: string,
    create: (canvas: HTMLCanvasElement) => PlayerLike,
    readonly failed: (why: string) => void,
  ) {
    this.#player = create(this.#canvas);
    this.#player.quality = rung;
    const scene = frame.querySelector(".scene")!;
    scene.append(this.#canvas);
    scene.after(this.#seam);
    this.#move(this.#at);
    this.#listen(frame);
  }

  /** The rung `split` of the package at `src` beside the one that plays; null where there is none of that name. */
  static beside(
    desk: Desk,
    frame: HTMLElement,
    { split, src }: { split: string; src: string },
    create: (canvas: HTMLCanvasElement) => PlayerLike,
    failed: (why: string) => void,
  ): Split | null {
    const names = desk.rungs.map(({ name }) => name);
    if (!names.includes(split)) {
      failed(`split=${split}: expected one of ${names.join(", ")}`);
      return null;
    }
    const made = new Split(desk, frame, split, create, failed);
    made.open(src);
    return made;
  }

  async open(src: string): Promise<void> {
    try {
      await this.#player.open(src);
      this.#open = true;
      this.resize();
    } catch (error) {
      this.#fail(String(error));
    }
  }

  #fail(why: string): void {
    if (this.desk.signal.aborted) return;
    this.close();
    this.failed(`There is no second picture: ${why}`);
  }

  close(): void {
    this.#open = false;
    this.#player.close();
    this.#canvas.remove();
    this.#seam.remove();
  }

  resize(): void {
    this.#player.resize(...this.desk.picture);
    this.follow();
  }

  follow(): void {
    const [first, second] = [this.desk.player, this.#player];
    if (!this.#open) return;
    if (second.camera !== first.camera) second.camera = first.camera;
    if (second.loop !== first.loop) second.loop = first.loop;
    this.#keepTime();
    const { rungs, rung } = first;
    const told = (one: RungInfo) =>
      [rungTitle(this.desk, one), rungFigures(this.desk, one)].filter(Boolean).join(" · ");
    const own = rungs.find(({ name }) => name === this.rung);
    write(this.#left, rung === null ? "" : told(rungs[rung]));
    write(this.#right, own ? told(own) : this.rung);
  }

  /** Of the two, the second one waits for the first, and catches up with it. */
  #keepTime(): void {
    const [first, second] = [this.desk.player, this.#player];
    const { duration, fps } = first;
    let behind = first.currentTime - second.currentTime;
    if (first.loop && Math.abs(behind) > duration / 2) behind -= Math.sign(behind) * duration; // one has begun again
    const stands = first.paused || first.ended || first.vr;
    const apart = Math.abs(behind) * fps > APART;
    if (apart && (stands || Math.abs(behind) > JUMP_S)) second.seek(first.currentTime);
    const speed = first.speed * (apart && behind > 0 ? FASTER : 1);
    if (second.speed !== speed) second.speed = speed;
    const waits = stands || (apart && behind < 0);
    if (waits !== second.paused) waits ? second.pause() : second.play();
  }

  #move(at: number): void {
    this.#at = Math.max(0, Math.min(at, 1));
    const left = `${(100 * this.#at).toFixed(1)}%`;
    this.#canvas.style.clipPath = `inset(0 0 0 ${left})`;
    this.#seam.style.left = left;
    this.#seam.ariaValueNow = String(Math.round(100 * this.#at));
  }

  #listen(frame: HTMLElement): void {
    const on = { signal: this.desk.signal };
    const seam = this.#seam;
    this.#player.addEventListener("firstpicture", () => seam.removeAttribute("hidden"), on);
    const problem = (event: Event) => {
      const { fatal, message } = (event as CustomEvent<Problem>).detail;
      if (fatal) this.#fail(message);
    };
    this.#player.addEventListener("problem", problem, on);
    seam.addEventListener("pointerdown", ({ pointerId }) => seam.setPointerCapture(pointerId), on);
    const drag = ({ pointerId, clientX }: PointerEvent) => {
      const { left, width } = frame.getBoundingClientRect();
      if (seam.hasPointerCapture(pointerId)) this.#move((clientX - left) / width);
    };
    seam.addEventListener("pointermove", drag, on);
    const steps: Readonly<Record<string, number>> = { ArrowLeft: -STEP, ArrowRight: STEP, Home: -1, End: 1 };
    const step = (event: KeyboardEvent) => {
      if (!steps[event.key]) return;
      event.preventDefault(); // the camera stays
      this.#move(this.#at + steps[event.key]);
    };
    seam.addEventListener("keydown", step, on);
  }
}

// An open package on its way to the canvas: files are fetched by a session, decoded ahead by a pipeline, and shown by a
// screen when their time has come. The schedule (`Playout`) is what these three agree on.
import type { Media } from "../media/client.ts";
import { TransportError } from "../media/errors.ts";
import type { TargetFormat } from "../render/textures.ts";
import type { SessionEvent } from "./downloader.ts";
import { Feed } from "./feed.ts";
import type { Offers } from "./offers.ts";
import { type Clip, Pipeline } from "./pipeline.ts";
import { EARLY, Playout, sessionSettings } from "./playout.ts";
import { wishedPolicy } from "./policies/mpc.ts";
import { RungTotals } from "./rungs.ts";
import type { Lack } from "./schedule.ts";
import { Screen } from "./screen.ts";
import type { PlayerStats, Statistics } from "./statistics.ts";
import { Stores } from "./stores.ts";
import { Held, Waits } from "./waits.ts";

const TIME_EVENT_S = 0.25;

export interface PlayerOptions {
  /** Name of a policy: robust-mpc (default), throughput, bola, paper, paper-literal; both also with -no-cliff. */
  policy?: string;
  loop?: boolean;
  /** Most media time that is fetched ahead, seconds; default 10. */
  bufferS?: number;
  /** Most bytes of files that are kept to be played again; default 64 MB. */
  keptBytes?: number;
  /** Most Gaussians that are fetched and shown of a group; default: any number. */
  budget?: number;
  /** Whether sound is silent, and how loud it is, 0 … 1; default: false and 1. */
  muted?: boolean;
  volume?: number;
  /** What splats are blended into; default: half floats, where the browser has them. */
  target?: TargetFormat;
}

/** What the viewer wants; it may change at any time. */
export type Wishes = PlayerOptions &
  Required<Pick<PlayerOptions, "policy" | "loop" | "muted" | "volume" | "bufferS">> & {
    /** "auto": what the policy chooses; else the name of a rung. */
    quality: string;
    paused: boolean;
    speed: number;
  };

/** The sound of a package, which is loaded where there is some: sound.ts. */
export interface Voice {
  readonly allowed: boolean;
  readonly leads: boolean;
  follow(): void;
  step(nowS: number, calm: boolean): void;
  close(): void;
}

export interface Problem {
  message: string;
  fatal: boolean;
  error: unknown;
}

export const problemOf = (error: unknown, fatal = false): Problem => {
  const message = error instanceof Error ? error.message : String(error);
  return { message, fatal, error };
};

const nowS = () => performance.now() / 1e3;

export class Playback {
  readonly screen: Screen;
  readonly playout: Playout;
  readonly #waits: Waits;
  readonly #held: Held;
  readonly #feed: Feed;
  readonly #stores: Stores;
  readonly #pipeline: Pipeline;
  readonly rungs: RungTotals;
  /** Shows the scene in place of the page while there is one. */
  headset: XRSession | null = null;
  /** Leads the pictures while it is heard; null: there is none, or it is not loaded yet. */
  sound: Voice | null = null;
  ended = false;
  readonly #end = new AbortController();
  #shown: { clip: Clip; frame: number } | null = null;
  #next: { position: number; frame: number } | null = { position: 0, frame: 0 };
  #sought: number | null = null;
  #locating = false;
  #waiting = false;
  #timeTold = Number.NEGATIVE_INFINITY;

  /** `offers` are of `media`, which is closed with the playback. */
  constructor(
    readonly media: Media,
    readonly offers: Offers,
    canvas: HTMLCanvasElement,
    readonly wishes: Wishes,
    readonly statistics: Statistics,
    readonly tell: (type: string, detail?: Problem) => void,
  ) {
    const { bufferS, target } = wishes;
    const settings = sessionSettings({ bufferS });
    const stores = new Stores(offers);
    this.#stores = stores;
    if (media.first) stores.first = media.first;
    const playout = new Playout(offers, settings, this.#lastPosition());
    const parts = { media, offers, stores, playout };
    this.playout = playout;
    this.#waits = new Waits(playout, () => this.sound?.leads ?? false);
    this.#held = new Held(offers, playout, statistics, wishes);
    this.rungs = new RungTotals(offers);
    this.#feed = new Feed({
      ...parts,
      settings,
      policy: () => wishedPolicy(wishes, offers),
      onEvent: (event) => this.#hear(event),
      onProblem: (error, fatal) => this.#problem(error, fatal),
    });
    this.#pipeline = new Pipeline({
      ...parts,
      onProgress: () => {
        this.#try(() => this.#prepare());
        const awaited = this.#sought !== null || !this.#shown;
        if (awaited && !this.headset && !document.hidden) this.step(() => this.screen.draw()); // displays may be slow to ask
      },
      onProblem: (error) => this.#problem(error, false),
    });
    this.screen = new Screen(canvas, media.tables, {
      target,
      onLost: () => {
        this.headset?.end(); // its layer is lost as well
        this.tell("lost");
      },
      onFail: (error) => this.#problem(error, true),
      onRestored: () => {
        const seconds = this.currentTime; // the picture is made again
        this.tell("restored");
        this.seek(seconds);
      },
    });
    this.playout.onChange(() => this.#pipeline.wake());
    document.addEventListener("visibilitychange", () => this.follow(), { signal: this.#end.signal });
  }

  begin(): void {
    this.follow();
    this.#feed.run(0);
    this.#tick();
  }

  close(): void {
    this.#end.abort();
    this.headset?.end();
    this.sound?.close();
    this.#feed.close();
    this.#pipeline.clear();
    this.screen.close();
    this.media.close();
  }

  resize(width: number, height: number): void {
    if (this.screen.resize(width, height)) this.#held.restart();
  }

  /** Take in what the viewer wants of the time: speed, and whether it passes. */
  follow(): void {
    const now = nowS();
    const { paused, speed } = this.wishes;
    if (speed !== this.playout.schedule.speed) {
      this.playout.setSpeed(now, speed);
      this.#held.restart();
    }
    this.playout.hold(now, "pause", paused);
    this.playout.hold(now, "hidden", document.hidden && !this.headset); // a page that nobody sees shows nothing
  }

  async choose(): Promise<void> {
    this.#held.offer();
    if (this.#locating) return this.seek(this.#sought ?? 0);
    const signal = await this.#feed.next();
    if (!signal.aborted) this.#goOn(signal);
  }

  #goOn(signal: AbortSignal): void {
    const position = this.playout.firstFree(nowS()) ?? this.#feed.from;
    this.playout.truncate(position);
    this.playout.end = this.#lastPosition();
    this.#feed.run(position, signal);
  }

  /** Go to a moment, seconds; the nearest one where there is none. */
  async seek(seconds: number): Promise<void> {
    const { fps, first } = this.offers;
    const frame = Math.floor(seconds * fps + EARLY);
    const near = Math.max(0, Math.min(this.media.tables.root.frames - 1, frame));
    this.#sought = near / fps;
    this.#locating = true;
    const signal = await this.#feed.next();
    if (signal.aborted) return;
    try {
      const position = (await this.media.locate(near, signal)) - first;
      this.#locating = false;
      this.#pipeline.clear();
      this.#next = null;
      this.statistics.waiting = false;
      this.playout.end = this.#lastPosition();
      this.playout.restart((near - this.offers.span(position).start) / fps);
      this.#feed.run(position, signal);
    } catch (error) {
      if (signal.aborted) return;
      this.#locating = false;
      this.#sought = null; // as if nobody had asked
      this.#problem(error, false);
      this.#goOn(signal);
    }
  }

  get seeking(): boolean {
    return this.#sought !== null;
  }

  get currentTime(): number {
    if (this.#sought !== null || !this.#shown) return this.#sought ?? 0;
    const { clip, frame } = this.#shown;
    return (this.offers.span(clip.position).start + frame) / this.offers.fps;
  }

  get rung(): number | null {
    return this.#shown?.clip.rung ?? null;
  }

  get stats(): PlayerStats {
    const { luma } = this.media;
    return this.statistics.read(nowS(), this.playout, luma, this.#shown?.clip ?? null, this.#held.told);
  }

  #lastPosition(): number {
    const loops = this.wishes.loop && !this.offers.live ? Number.POSITIVE_INFINITY : 1;
    return this.offers.end(loops);
  }

  #hear(event: SessionEvent): void {
    if (event.type === "arrived") this.statistics.arrived(event);
    const why = event.type === "lost" && this.#stores.whyLost(event.position);
    if (why) this.#problem(why, false);
    if (event.type === "cut") this.#problem(new TransportError(event.why), false);
    this.tell("progress");
  }

  #prepare(): void {
    const clips = [...this.#pipeline.clips];
    for (const clip of clips) this.screen.prepare(clip);
    this.screen.retain(new Set(clips.map((clip) => clip.canonical)));
  }

  readonly #tick = (): void => {
    if (this.#end.signal.aborted) return;
    requestAnimationFrame(this.#tick);
    if (!this.headset) this.step(() => this.screen.draw());
  };

  /** Show what is due in a frame of the display; `draw` says whether it drew a picture. */
  step(draw: () => boolean): void {
    const now = nowS();
    this.#waits.tick(now);
    this.sound?.step(now, this.#waits.calm(now));
    this.#try(() => {
      this.#advance(now);
      const isNew = this.statistics.waiting;
      if (!draw()) return;
      if (this.statistics.drawn(now)) this.tell("firstpicture");
      if (isNew && this.#shown && this.#held.drawn(this.#shown.clip)) this.choose();
    });
  }

  /** Show the frame that is due; where it is not there, the schedule waits for it. */
  #advance(now: number): void {
    const due = this.playout.at(now);
    const begins = this.#sought !== null || !this.#shown;
    const lack = due && this.#show(due.slot.position, due.slot.rung, due.frame);
    this.#waits.lack(now, lack && begins ? "start" : lack);
    const over = !lack && this.playout.done(now);
    this.#tellWaiting((lack !== null && begins) || (this.playout.waits(now) && !over));
    const ended = over && !this.statistics.waiting;
    if (ended && !this.ended) this.tell("ended");
    this.ended = ended;
  }

  /** What a frame lacks; null: it is on the screen, or nothing can be shown in its place but what is there. */
  #show(position: number, rung: number | null, frame: number): Lack | null {
    this.#pipeline.due(position, frame);
    const clip = this.#pipeline.clip(position);
    if (rung === null) return null;
    if (clip && this.#shown?.clip === clip && this.#shown.frame === frame) return null;
    if (clip?.frames[frame] === undefined) return "decoder";
    if (!this.screen.show(clip, frame)) return "display";
    const before = this.#shown;
    this.statistics.shown(this.#passedOver(position, frame));
    this.#shown = { clip, frame };
    this.#next = { position, frame: frame + 1 };
    if (!this.#locating) this.#sought = null; // until then, what is shown is from before the seek
    this.#pipeline.shown(clip, frame);
    if (before?.clip.rung !== clip.rung) this.tell("rung");
    if (nowS() - this.#timeTold >= TIME_EVENT_S) {
      this.#timeTold = nowS();
      this.tell("time");
    }
    return null;
  }

  /** Frames that nobody saw before this one: those of segments that were lost, and those that had no time. */
  #passedOver(position: number, frame: number): { lost: number; late: number } {
    const next = this.#next ?? { position, frame };
    const count = { lost: 0, late: 0 };
    for (let p = next.position; p <= position; p++) {
      const { start, stop } = this.offers.span(p);
      const isLost = this.playout.slots.some((slot) => slot.position === p && slot.rung === null);
      count[isLost ? "lost" : "late"] += (p < position ? stop - start : frame) - (p === next.position ? next.frame : 0);
    }
    return count;
  }

  #tellWaiting(waiting: boolean): void {
    if (waiting === this.#waiting || this.wishes.paused) return;
    this.#waiting = waiting;
    this.tell(waiting ? "stall" : "resume");
  }

  /** What the renderer refuses, such as more rows than its textures hold, ends everything. */
  #try(action: () => void): void {
    try {
      action();
    } catch (error) {
      this.close();
      this.#problem(error, true);
    }
  }

  #problem(error: unknown, fatal: boolean): void {
    this.tell("problem", problemOf(error, fatal));
  }
}

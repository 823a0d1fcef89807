// One life of the element: from a source to a player, a camera and controls, until it is closed.

import type { Problem } from "../play/playback.ts";
import type { RungInfo } from "../play/rungs.ts";
import { rungColours } from "./colours.ts";
import type { Desk } from "./desk.ts";
import { EVENTS, type PlayerLike, type PlayerSettings } from "./desk.ts";
import { Gestures } from "./gestures.ts";
import { listenToKeys } from "./keys.ts";
import { Orbit } from "./orbit.ts";
import { pictureSize, Sharpness } from "./sharpness.ts";
import { FullScreen, type Looks, Shell } from "./shell.ts";
import { troubleOf } from "./trouble.ts";

const UPDATE_MS = 250;
/** The figures of rungs change as tables come, and a player takes long to sum them up. */
const LIST_MS = 2000;
const NOTE_MS = 7000;
/** A click waits so long for a second one. */
const CLICK_MS = 280;
/** A longer step of time was no step: the page was hidden. */
const LONGEST_S = 0.1;

const GUESSED = "No cameras came with this scene: the first view is a guess.";
const OFFLINE = "There is no network. Trying again …";
const LOST = "The graphics card has been taken away. Waiting for it …";
/** So long a trouble stays to be read when it is over. */
const READ_MS = 2500;
const OUTSIDE = "Outside the viewing region: no quality is promised here.";

/** What a view is made of: the attributes of the element. */
export interface Plan extends Looks {
  readonly autoplay: boolean;
  readonly free: boolean;
  readonly quality: string;
  readonly settings: PlayerSettings;
}

/** The element, as a view knows it. */
export interface Owner {
  readonly host: HTMLElement;
  create(canvas: HTMLCanvasElement, settings: PlayerSettings): PlayerLike;
  /** Start anew with the same source. */
  again(): void;
}

export class View implements Desk {
  readonly player: PlayerLike;
  orbit = new Orbit();
  rungs: readonly RungInfo[] = [];
  colours: readonly string[] = [];
  ready = false;
  picture: readonly [number, number] = [1, 1];
  readonly #end = new AbortController();
  readonly #shell: Shell;
  readonly #full: FullScreen;
  readonly #sharpness = new Sharpness(() => this.#resize());
  readonly #still = window.matchMedia("(prefers-reduced-motion: reduce)");
  readonly #watch = new ResizeObserver(([entry]) => this.#resized(entry.contentRect));
  #area = { width: 0, height: 0 };
  #request = 0;
  /** When the last animation frame was; 0: the one before was long ago. */
  #last = 0;
  #updated = 0;
  #listed = 0;
  #click = 0;

  constructor(
    readonly owner: Owner,
    readonly plan: Plan,
    root: ShadowRoot,
  ) {
    this.#shell = new Shell(this, plan, root);
    this.player = owner.create(this.#shell.canvas, plan.settings);
    this.#full = new FullScreen(owner.host, () => this.wake(), this.signal);
    this.#listen();
    this.#watch.observe(this.#shell.frame);
    this.#shell.stir();
    this.#open();
  }

  get signal(): AbortSignal {
    return this.#end.signal;
  }

  get full(): boolean {
    return this.#full.on;
  }

  get scale(): number {
    return this.#sharpness.scale;
  }

  close(): void {
    this.#end.abort();
    this.#watch.disconnect();
    cancelAnimationFrame(this.#request);
    window.clearTimeout(this.#click);
    this.#sharpness.close();
    this.#shell.close();
    this.player.close();
  }

  toggle(): void {
    if (!this.ready) return;
    if (this.player.ended) this.player.seek(0);
    if (this.player.paused || this.player.ended) this.player.play();
    else this.player.pause();
    this.#shell.stir();
    this.wake();
  }

  seek(seconds: number): void {
    if (!this.ready) return;
    this.player.seek(Math.max(0, Math.min(seconds, this.player.duration)));
    this.wake();
  }

  skip(seconds: number): void {
    this.seek(this.#shell.bar.timeline.time + seconds);
  }

  frame(count: number): void {
    if (!this.ready) return;
    if (!this.player.paused) this.player.pause();
    this.seek(this.player.currentTime + count / this.player.fps);
  }

  home(): void {
    this.orbit.reset();
    this.wake();
  }

  toggleFull(): void {
    this.#full.toggle().then(() => this.wake());
  }

  toggleInfo(): void {
    this.#shell.panel.toggle();
    this.#shell.update();
    this.wake();
  }

  setLoop(loop: boolean): void {
    this.owner.host.toggleAttribute("loop", loop);
  }

  setQuality(quality: string): void {
    this.owner.host.setAttribute("quality", quality);
  }

  setPolicy(policy: string): void {
    this.owner.host.setAttribute("policy", policy);
  }

  setFree(free: boolean): void {
    this.owner.host.setAttribute("view-region", free ? "free" : "bounded");
  }

  /** Take over an attribute that has changed. */
  apply(change: Partial<Pick<PlayerLike, "loop" | "quality" | "policy" | "speed">> & { free?: boolean }): void {
    const { free, ...settings } = change;
    if (free !== undefined) this.orbit.setFree(free);
    try {
      Object.assign(this.player, settings);
    } catch (error) {
      this.#shell.notes.show("setting", error instanceof Error ? error.message : String(error), NOTE_MS);
    }
    this.wake();
  }

  wake(): void {
    if (!this.#request && !this.signal.aborted) this.#request = requestAnimationFrame((now) => this.#tick(now));
  }

  async #open(): Promise<void> {
    const { player, plan } = this;
    try {
      if (plan.quality !== "auto") player.quality = plan.quality;
      await player.open(plan.src);
    } catch (error) {
      if (!this.signal.aborted) this.#fail(error);
      return;
    }
    if (this.signal.aborted) return;
    this.ready = true;
    this.orbit = new Orbit(player.region);
    this.orbit.reduced = this.#still.matches;
    this.orbit.free = plan.free;
    this.#list(performance.now());
    this.#look();
    if (player.region?.source === "orbit") this.#shell.notes.show("guess", GUESSED, NOTE_MS);
    if (plan.autoplay) await player.play();
    this.#shell.update();
    this.wake();
  }

  #fail(error: unknown): void {
    this.#shell.showTrouble(troubleOf(error, this.plan.src), () => this.owner.again());
  }

  #look(): void {
    const { width, height } = this.#area;
    if (!this.ready || width === 0 || height === 0) return;
    this.player.camera = this.orbit.view(width / height);
    this.#shell.strain = this.orbit.strain;
    if (this.orbit.outside && this.orbit.free) this.#shell.notes.show("outside", OUTSIDE);
    else this.#shell.notes.hide("outside");
  }

  #resized({ width, height }: DOMRectReadOnly): void {
    this.#area = { width, height };
    this.#resize();
  }

  /** As many pixels as can be drawn in time. */
  #resize(): void {
    const { width, height } = this.#area;
    this.picture = pictureSize(width, height, window.devicePixelRatio, this.scale);
    this.player.resize(...this.picture);
    this.#look();
    this.wake();
  }

  #tick(now: number): void {
    this.#request = 0;
    const { player, orbit } = this;
    const interval = this.#last ? now - this.#last : 0;
    const moved = orbit.step(Math.min(interval / 1000, LONGEST_S));
    if (moved || orbit.held) this.#look();
    const plays = this.ready && !player.paused && !player.ended;
    const goesOn = plays || moved || orbit.held || orbit.moving || this.#shell.bar.timeline.scrubbing;
    this.#sharpness.tick(now, { goesOn, moved, plays: plays && !this.#shell.waiting }, player);
    if (!goesOn || now - this.#updated > UPDATE_MS) {
      this.#updated = now;
      if (now - this.#listed > LIST_MS) this.#list(now);
      this.#shell.update();
    } else {
      this.#shell.bar.updateTime();
    }
    this.#last = goesOn ? now : 0;
    if (goesOn) this.wake();
  }

  #list(now: number): void {
    this.#listed = now;
    this.rungs = this.player.rungs;
    this.colours = rungColours(this.rungs);
  }

  #listen(): void {
    const { player, signal } = this;
    const { host } = this.owner;
    const retell = (event: Event) => {
      const detail: unknown = event instanceof CustomEvent ? event.detail : null;
      this.#hear(event.type, detail);
      host.dispatchEvent(new CustomEvent(event.type, { detail }));
      this.wake();
    };
    for (const name of EVENTS) player.addEventListener(name, retell, { signal });
    const on = { signal };
    this.#still.addEventListener("change", () => (this.orbit.reduced = this.#still.matches), on);
    window.addEventListener("offline", () => this.#shell.notes.show("network", OFFLINE), on);
    window.addEventListener("online", () => this.#shell.notes.hide("network", READ_MS), on);
    listenToKeys(this.#shell.frame, this, signal);
    new Gestures(
      this.#shell.scene,
      () => this.orbit,
      { moved: () => this.wake(), tap: (event) => this.#tap(event), doubleTap: () => this.#doubleTap() },
      () => this.full || host.hasAttribute("capture"),
      signal,
    );
  }

  /** Shows what follows from an event of the player. */
  #hear(name: string, detail: unknown): void {
    const { notes } = this.#shell;
    if (name === "firstpicture") this.#shell.showPicture();
    else if (name === "stall" || name === "resume") this.#shell.waiting = name === "stall";
    else if (name === "progress") notes.hide("network", READ_MS);
    else if (name === "lost") notes.show("lost", LOST);
    else if (name === "restored") notes.hide("lost");
    else if (name === "pause" || name === "ended") this.#shell.stir();
    else if (name === "problem") this.#problem(detail as Problem);
  }

  #problem({ message, fatal, error }: Problem): void {
    if (fatal) this.#fail(error ?? new Error(message));
    else this.#shell.notes.show("network", navigator.onLine ? message : OFFLINE);
  }

  /** A click plays and pauses, a finger shows and hides the controls, as players of videos do. */
  #tap(event: PointerEvent): void {
    if (!this.plan.controls) return;
    if (event.pointerType === "touch" && !this.#shell.fresh) this.#shell.toggleControls();
    else this.#click = window.setTimeout(() => this.toggle(), CLICK_MS);
  }

  #doubleTap(): void {
    window.clearTimeout(this.#click);
    this.home();
  }
}

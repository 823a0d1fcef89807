// One life of the element: from a source to a player, a camera and controls, until it is closed.
import { FormatError } from "../format/errors.ts";
import type { Problem } from "../play/playback.ts";
import type { RungInfo } from "../play/rungs.ts";
import { EVENTS, type PlayerLike, type PlayerSettings } from "./desk.ts";
import { Orbit } from "./orbit.ts";
import { pictureSize, type Sharpness } from "./sharpness.ts";
import { type FullScreen, type Looks, loadMore, type More, Shell } from "./shell.ts";
import type { Split } from "./split.ts";
import type { Subject } from "./subject.ts";
import { ranked, rungColours } from "./words.ts";

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

/** The element: what its attributes say, and what it does for its view. */
export interface Owner extends HTMLElement, Looks {
  readonly autoplay: boolean;
  readonly viewRegion: "bounded" | "free";
  readonly quality: string;
  /** Whether the address of the page is read, and offered. */
  readonly hash: boolean;
  /** A rung that is shown beside the one that plays; "": none. */
  readonly split: string;
  /** The address of a camera path; "": none. */
  readonly path: string;
  readonly settings: PlayerSettings;
  create(canvas: HTMLCanvasElement, settings: PlayerSettings): PlayerLike;
  again(): void;
}

export class View {
  readonly player: PlayerLike;
  orbit = new Orbit();
  rungs: readonly RungInfo[] = [];
  colours: readonly string[] = [];
  ready = false;
  headset = false;
  picture: readonly [number, number] = [1, 1];
  readonly #end = new AbortController();
  readonly #shell: Shell;
  readonly #began: string;
  /** These three come after the first picture. */
  #more: More | null = null;
  #full: FullScreen | null = null;
  #sharpness: Sharpness | null = null;
  readonly #still = window.matchMedia("(prefers-reduced-motion: reduce)");
  readonly #watch = new ResizeObserver(([{ contentRect }]) => {
    this.#area = { width: contentRect.width, height: contentRect.height };
    this.#resize();
  });
  #area = { width: 0, height: 0 };
  #request = 0;
  /** When the last animation frame was; 0: the one before was long ago. */
  #last = 0;
  #updated = 0;
  #listed = 0;
  #click = 0;
  #split: Split | null = null;

  constructor(
    readonly owner: Owner,
    root: ShadowRoot,
  ) {
    this.#began = owner.hash ? location.hash.slice(1) : "";
    this.#shell = new Shell(this, owner, root, (more) => this.#add(more));
    this.player = owner.create(this.#shell.canvas, owner.settings);
    this.#listen();
    this.#watch.observe(this.#shell.frame);
    this.#shell.stir();
    this.#seekHeadset();
    this.#open();
  }

  get signal(): AbortSignal {
    return this.#end.signal;
  }

  get full(): boolean {
    return !!this.#full?.on;
  }

  get still(): boolean {
    const { live, duration, fps } = this.player;
    return !live && Math.round(duration * fps) === 1;
  }

  get split(): boolean {
    return !!this.#split;
  }

  get comparable(): boolean {
    return this.rungs.filter(({ onLadder }) => onLadder).length > 1;
  }

  get scale(): number {
    return this.#sharpness?.scale ?? 1;
  }

  close(): void {
    this.#end.abort();
    this.#watch.disconnect();
    cancelAnimationFrame(this.#request);
    window.clearTimeout(this.#click);
    this.#sharpness?.close();
    this.#shell.close();
    this.#split?.close();
    this.player.close();
  }

  toggle(): void {
    if (!this.ready || this.still) return;
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

  home(first = false): void {
    if (first) this.orbit.begin(null);
    else this.orbit.reset();
    this.wake();
  }

  beginHere(): void {
    this.orbit.begin(this.orbit.stance);
    this.#say("begin", "The view begins here now.");
  }

  turnOver(): void {
    this.orbit.turnOver();
    this.#look();
  }

  showSubject(): void {
    const { width, height } = this.#area;
    const subject = this.#subject();
    if (subject) this.orbit.show(subject, width / height);
    this.wake();
  }

  #subject(): Subject | null {
    const drawn = this.#more && this.player.drawn();
    return drawn ? this.#more!.subjectAt(drawn, this.orbit.pivot) : null;
  }

  /** Look at what is under a pointer; beside the subject, go back. */
  #lookAt({ clientX, clientY }: PointerEvent): void {
    const { left, top, width, height } = this.#shell.canvas.getBoundingClientRect();
    const drawn = this.player.drawn();
    const point = drawn && this.#more!.pointAt(drawn, (clientX - left) / width, (clientY - top) / height);
    if (point) this.orbit.lookAt(point);
    else this.home();
    this.wake();
  }

  toggleSplit(): void {
    const smallest = ranked(this.rungs).find((rung) => this.rungs[rung].onLadder);
    this.#split?.close();
    if (this.#split || smallest === undefined) this.#split = null;
    else this.#shell.use(() => this.#beside(this.rungs[smallest].name));
    this.wake();
  }

  toggleKeys(): void {
    this.#shell.toggleKeys();
  }

  get linked(): boolean {
    return this.owner.hash;
  }

  get at(): string {
    return this.ready && this.#more ? this.#more.momentOf(this) : this.#began;
  }

  /** Go to a moment that is told as text. What cannot be done of it is said, and the rest done. */
  async go(text: string): Promise<void> {
    if (!this.ready) return;
    await this.#shell.use(() => {
      const wrong = this.#more!.goTo(this, text);
      if (wrong.length > 0) this.#say("address", `Not taken from the address: ${wrong.join("; ")}`);
    });
    this.#look();
    this.wake();
  }

  async copyLink(): Promise<void> {
    if (this.ready && this.linked && this.#more) this.#say("copied", await this.#more.copyLink(this));
  }

  toggleFull(): void {
    this.#full?.toggle().then(() => this.wake());
  }

  toggleVr(): void {
    const { player } = this;
    if (player.vr) player.leaveVr();
    else player.enterVr().catch((error: Error) => this.#shell.notes.show("vr", error.message, NOTE_MS));
  }

  toggleSound(): void {
    const muted = !this.player.muted;
    if (!this.player.hasSound) return;
    this.set("muted", muted);
    this.apply({ muted });
  }

  toggleInfo(): void {
    this.#shell.use(({ panel }) => {
      panel.toggle();
      this.#shell.update();
      this.wake();
    });
  }

  set(attribute: "loop" | "quality" | "policy" | "view-region" | "muted", value: string | boolean): void {
    if (typeof value === "string") this.owner.setAttribute(attribute, value);
    else this.owner.toggleAttribute(attribute, value);
  }

  apply(settings: Partial<Pick<PlayerLike, "loop" | "quality" | "policy" | "muted" | "volume">>, free?: boolean): void {
    if (free !== undefined) this.orbit.setFree(free);
    try {
      Object.assign(this.player, settings);
      if (settings.quality && this.still) this.player.seek(0); // nothing else would show it
    } catch (error) {
      this.#say("setting", error instanceof Error ? error.message : String(error));
    }
    this.wake();
  }

  wake(): void {
    if (!this.#request && !this.signal.aborted) this.#request = requestAnimationFrame((now) => this.#tick(now));
  }

  async #seekHeadset(): Promise<void> {
    this.headset = !!(await navigator.xr?.isSessionSupported("immersive-vr").catch(() => false));
    this.wake();
  }

  async #open(): Promise<void> {
    const { player, owner } = this;
    const address = owner.path && new URL(owner.path, owner.baseURI).href;
    const path = address ? loadMore().then(({ fetchCameraPath }) => fetchCameraPath(address)) : null;
    path?.catch(() => {}); // it is waited for below
    try {
      if (owner.quality !== "auto") player.quality = owner.quality;
      await player.open(owner.src);
    } catch (error) {
      if (!this.signal.aborted) this.#fail(error);
      return;
    }
    await Promise.allSettled([path]);
    if (this.signal.aborted) return;
    this.ready = true;
    this.orbit = new Orbit(player.region);
    if (player.region) this.#shell.region = player.region;
    this.orbit.free = owner.viewRegion === "free";
    try {
      if (path) this.orbit.follow(await path);
    } catch (error) {
      this.#say("path", `The camera path cannot be used: ${(error as Error).message}`);
    }
    this.#list(performance.now());
    this.orbit.reduced = true; // nothing was seen yet that one could glide from
    if (this.#began) await this.go(this.#began);
    else this.#look();
    this.orbit.reduced = this.#still.matches;
    if (player.region?.source === "orbit") this.#say("guess", GUESSED);
    if (owner.split) this.#shell.use(() => this.#beside(owner.split));
    if (owner.autoplay && !this.still) await player.play();
    this.#shell.update();
    this.wake();
  }

  #beside(split: string): void {
    const { owner } = this;
    const { src } = owner;
    const create = (canvas: HTMLCanvasElement) => owner.create(canvas, { ...owner.settings, muted: true });
    const failed = (why: string) => this.#say("split", why);
    this.#split = this.#more!.Split.beside(this, this.#shell.frame, { split, src }, create, failed);
    this.wake();
  }

  #say(name: string, text: string): void {
    this.#shell.notes.show(name, text, NOTE_MS);
  }

  #fail(error: unknown): void {
    this.#shell.showTrouble(error, () => this.owner.again());
  }

  #look(): void {
    const { width, height } = this.#area;
    if (!this.ready || width === 0 || height === 0) return;
    this.player.camera = this.orbit.view(width / height);
    this.#split?.follow();
    this.#shell.strain = this.orbit.strain;
    if (this.orbit.outside && this.orbit.free) this.#shell.notes.show("outside", OUTSIDE);
    else this.#shell.notes.hide("outside");
  }

  #resize(): void {
    const { width, height } = this.#area;
    this.picture = pictureSize(width, height, window.devicePixelRatio, this.scale);
    this.player.resize(...this.picture);
    this.#split?.resize();
    this.#look();
    this.wake();
  }

  #tick(now: number): void {
    this.#request = 0;
    const { player, orbit } = this;
    const interval = this.#last ? now - this.#last : 0;
    const plays = this.ready && !player.paused && !player.ended && !this.still;
    const seconds = Math.min(interval / 1000, LONGEST_S);
    const moved = orbit.step(seconds, plays && !this.#shell.waiting ? player.speed * seconds : 0);
    if (moved || orbit.held) this.#look();
    const goesOn = plays || moved || orbit.held || orbit.moving || this.#shell.bar.timeline.scrubbing;
    this.#sharpness?.tick(now, { goesOn, moved, plays: plays && !this.#shell.waiting }, player);
    if (!goesOn || now - this.#updated > UPDATE_MS) {
      this.#updated = now;
      if (now - this.#listed > LIST_MS || this.rungs.some(({ kbps }) => !kbps)) this.#list(now);
      this.#shell.update();
    } else {
      this.#shell.bar.updateTime();
    }
    this.#split?.follow();
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
    const host = this.owner;
    const retell = (event: Event) => {
      const detail: unknown = event instanceof CustomEvent ? event.detail : null;
      this.#hear(event.type, detail);
      host.dispatchEvent(new CustomEvent(event.type, { detail }));
      this.wake();
    };
    for (const name of EVENTS) player.addEventListener(name, retell, { signal });
    const on = { signal };
    this.#still.addEventListener("change", () => (this.orbit.reduced = this.#still.matches), on);
    navigator.xr?.addEventListener("devicechange", () => this.#seekHeadset(), on);
    window.addEventListener("offline", () => this.#shell.notes.show("network", OFFLINE), on);
    window.addEventListener("online", () => this.#shell.notes.hide("network", READ_MS), on);
    if (this.linked) window.addEventListener("hashchange", () => this.go(location.hash.slice(1)), on);
  }

  #add(more: More): void {
    const { FullScreen, Gestures, Scrub, Sharpness, listenToKeys } = more;
    this.#more = more;
    const { signal, owner: host } = this;
    this.#full = new FullScreen(host, () => this.wake(), signal);
    this.#sharpness = new Sharpness(() => this.#resize());
    new Scrub(this, this.#shell.bar.timeline);
    listenToKeys(this.#shell.frame, this, signal);
    new Gestures(
      this.#shell.scene,
      () => this.orbit,
      {
        moved: () => this.wake(),
        tap: (event) => this.#tap(event),
        doubleTap: (event) => {
          window.clearTimeout(this.#click);
          this.#lookAt(event);
        },
      },
      () => this.full || host.hasAttribute("capture"),
      signal,
    );
    const subject = this.#subject();
    if (subject) this.orbit.pivot = subject.middle;
  }

  #hear(name: string, detail: unknown): void {
    const { notes } = this.#shell;
    if (name === "poster" && detail instanceof Blob) this.#shell.showPoster(detail);
    else if (name === "firstpicture") this.#shell.showPicture(!this.#began && !this.owner.path);
    else if (name === "stall" || name === "resume") this.#shell.waiting = name === "stall";
    else if (name === "progress") notes.hide("network", READ_MS);
    else if (name === "lost") notes.show("lost", LOST);
    else if (name === "restored") notes.hide("lost");
    else if (name === "pause" || name === "ended") this.#shell.stir();
    else if (name === "problem") this.#problem(detail as Problem);
  }

  #problem({ message, fatal, error }: Problem): void {
    if (fatal || (this.#shell.blank && error instanceof FormatError)) this.#fail(error ?? new Error(message));
    else if ((error as Error | null)?.name === "UnsupportedError") this.#say("sound", message);
    else this.#shell.notes.show("network", navigator.onLine ? message : OFFLINE);
  }

  /** A click plays and pauses, a finger shows and hides the controls, as players of videos do. */
  #tap(event: PointerEvent): void {
    if (!this.owner.controls) return;
    if (event.pointerType === "touch" && !this.#shell.fresh) this.#shell.toggleControls();
    else this.#click = window.setTimeout(() => this.toggle(), CLICK_MS);
  }
}

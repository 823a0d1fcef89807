// The player as a page sees it: what the viewer wants, what is told of it, and the package that is open.
import { firstView, levelled, type ViewState } from "../format/region.ts";
import type { Region, World } from "../format/types.ts";
import { DEFAULT_POLICY, HEADER_BYTES, SESSION } from "../generated/constants.ts";
import { Media } from "../media/client.ts";
import type { Drawn } from "../render/renderer.ts";
import { joinNewest } from "./downloader.ts";
import { Offers } from "./offers.ts";
import { Playback, type PlayerOptions, type Problem, problemOf, type Wishes } from "./playback.ts";
import type { RungInfo } from "./rungs.ts";
import { type PlayerStats, Statistics } from "./statistics.ts";

const NOWHERE: ViewState = { position: [0, 0, 0], forward: [0, 0, 1], up: [0, -1, 0], fovY: 50, near: 0.01 };

/** Plays a package on a canvas.
 *
 * Events: "open" (tables are there), "firstpicture", "play", "pause", "time" (four times a second), "progress"
 * (something was fetched), "rung" (another rung is on the screen), "stall" and "resume", "ended", "vr" (a headset shows
 * it, or does no more), "volumechange" (of the sound, also when it comes), "lost" and "restored" (the WebGL context),
 * "problem" (detail: `Problem`).
 */
export class Player extends EventTarget {
  readonly #wishes: Wishes;
  readonly #statistics = new Statistics();
  #playback: Playback | null = null;
  #view: ViewState | null = null;
  #size = { width: 1, height: 1 };
  #opened = 0;

  constructor(
    readonly canvas: HTMLCanvasElement,
    options: PlayerOptions = {},
  ) {
    super();
    const given = { policy: DEFAULT_POLICY, loop: true, bufferS: SESSION.bufferS, muted: false, volume: 1, ...options };
    this.#wishes = { ...given, quality: "auto", speed: 1, paused: true };
  }

  /** Open a package by the address of its folder, its airgs.json or its manifest.mpd; it moves after `play`.
   *
   * Throws FormatError for what is no package, TransportError where it cannot be fetched, UnsupportedError where the
   * browser cannot play it. Where another package is opened meanwhile, or the player is closed, nothing comes of it.
   */
  async open(src: string): Promise<void> {
    const turn = ++this.#opened;
    const onPoster = (poster: Blob) => turn === this.#opened && this.#tell("poster", poster);
    const onPassing = (words: string) => turn === this.#opened && this.#tell("problem", problemOf(words));
    const media = await Media.open(src, { ...this.#wishes, onPoster, onPassing });
    try {
      const offers = new Offers(media.tables, HEADER_BYTES, this.#wishes.budget);
      await joinNewest(offers, media);
      if (turn !== this.#opened) return media.close();
      this.#playback?.close();
      this.#playback = null;
      this.#playback = new Playback(media, offers, this.canvas, this.#wishes, this.#statistics, this.#tell);
    } catch (error) {
      media.close();
      throw error;
    }
    const region = levelled(this.#playback.media.tables.root);
    this.camera = this.#view ?? firstView(region);
    this.resize(this.#size.width, this.#size.height);
    this.#tell("open");
    this.#playback.begin();
    if (media.tables.root.sound) this.#addSound(this.#playback);
  }

  async #addSound(playback: Playback): Promise<void> {
    try {
      const { Sound } = await import("./sound.ts"); // beside this script, as few need it
      const sound = await Sound.of(playback);
      if (playback !== this.#playback) return sound.close();
      playback.sound = sound;
      this.#tell("volumechange");
    } catch (error) {
      if (playback === this.#playback) this.#tell("problem", problemOf(error));
    }
  }

  close(): void {
    this.#opened++;
    this.#playback?.close();
    this.#playback = null;
  }

  on(type: string, listener: (event: Event) => void): () => void {
    this.addEventListener(type, listener);
    return () => this.removeEventListener(type, listener);
  }

  play(): void {
    const { ended } = this;
    if (!this.paused && !ended) return;
    this.#wishes.paused = false;
    this.#playback?.follow();
    if (ended) this.seek(0);
    this.#tell("play");
  }

  pause(): void {
    if (this.#wishes.paused) return;
    this.#wishes.paused = true;
    this.#playback?.follow();
    this.#tell("pause");
  }

  /** Go to a moment of the sequence, seconds. What is on the screen stays until the new picture is there. */
  async seek(seconds: number): Promise<void> {
    await this.#playback?.seek(seconds);
  }

  get paused(): boolean {
    return this.#wishes.paused;
  }

  /** Whether all was shown, and nothing is repeated. */
  get ended(): boolean {
    return this.#playback?.ended ?? false;
  }

  /** Whether the moment that was sought is not on the screen yet. */
  get seeking(): boolean {
    return this.#playback?.seeking ?? false;
  }

  get live(): boolean {
    return this.#playback?.offers.live ?? false;
  }

  get loop(): boolean {
    return this.#wishes.loop;
  }

  set loop(loop: boolean) {
    this.#wishes.loop = loop;
    this.#playback?.choose();
  }

  /** Seconds of the sequence a second. */
  get speed(): number {
    return this.#wishes.speed;
  }

  set speed(speed: number) {
    this.#wishes.speed = speed;
    this.#playback?.follow();
  }

  get hasSound(): boolean {
    return !!this.#playback?.sound;
  }

  /** Whether sound is silent; it is until somebody touches the page, where the browser wants that. */
  get muted(): boolean {
    return this.#wishes.muted || !this.#playback?.sound?.allowed;
  }

  set muted(muted: boolean) {
    this.#wishes.muted = muted;
    this.#playback?.sound?.follow();
    this.#tell("volumechange");
  }

  get volume(): number {
    return this.#wishes.volume;
  }

  set volume(volume: number) {
    this.#wishes.volume = Math.max(0, Math.min(1, volume));
    this.#playback?.sound?.follow();
    this.#tell("volumechange");
  }

  /** Frames a second of the sequence at speed 1; 0 before a package is open. */
  get fps(): number {
    return this.#playback?.offers.fps ?? 0;
  }

  /** The moment of the sequence that is on the screen, or is sought, seconds. */
  get currentTime(): number {
    return this.#playback?.currentTime ?? 0;
  }

  /** Seconds of the sequence so far; 0 before a package is open. */
  get duration(): number {
    return this.#playback?.offers.durationS ?? 0;
  }

  /** Parts of the sequence that are at hand, seconds, with the numbers of their rungs. */
  get buffered(): { start: number; stop: number; rung: number }[] {
    return this.#playback?.playout.buffered(performance.now() / 1e3) ?? [];
  }

  /** What can be chosen, the best quality of keyframes first; figures are of the part of the package that was seen. */
  get rungs(): RungInfo[] {
    return this.#playback?.rungs.read() ?? [];
  }

  get rung(): number | null {
    return this.#playback?.rung ?? null;
  }

  /** "auto", or the name of a rung that is always played. */
  get quality(): string {
    return this.#wishes.quality;
  }

  set quality(quality: string) {
    this.#wishes.quality = quality;
    this.#playback?.choose();
  }

  /** What chooses rungs where `quality` is "auto". */
  get policy(): string {
    return this.#wishes.policy;
  }

  set policy(policy: string) {
    this.#wishes.policy = policy;
    this.#playback?.choose();
  }

  /** Where the quality of the package is promised. */
  get region(): Region | null {
    return this.#playback && levelled(this.#playback.media.tables.root);
  }

  /** Where the scene stands in a world with y up, as far as somebody told. */
  get world(): World | null {
    return this.#playback?.media.tables.root.world ?? null;
  }

  get camera(): ViewState {
    return this.#view ?? NOWHERE;
  }

  set camera(view: ViewState) {
    this.#view = view;
    if (!this.vr) this.#playback?.screen.look(view);
  }

  /** Whether a headset shows the scene, from where its wearer looks. */
  get vr(): boolean {
    return !!this.#playback?.headset;
  }

  /** Show the scene in a headset, until its wearer or `leaveVr` ends that. Browsers allow it when a button was pressed.
   *
   * Throws DOMException where they do not, TypeError where airgs-vr.js is not beside this script.
   */
  async enterVr(): Promise<void> {
    const playback = this.#playback;
    const { enter } = await import("./vr.ts");
    if (!playback || playback !== this.#playback || this.vr) return;
    await enter(
      playback,
      () => this.#changeDisplay(),
      () => (this.paused ? this.play() : this.pause()),
    );
    if (playback !== this.#playback) playback.headset?.end(); // closed meanwhile
    this.#changeDisplay();
  }

  leaveVr(): void {
    this.#playback?.headset?.end();
  }

  #changeDisplay(): void {
    this.resize(this.#size.width, this.#size.height);
    this.camera = this.camera;
    this.#playback?.follow();
    this.#tell("vr");
  }

  /** What the last picture shows of each Gaussian; null: there is no picture. */
  drawn(): Drawn | null {
    return this.#playback?.screen.read() ?? null;
  }

  get stats(): PlayerStats {
    return this.#playback?.stats ?? this.#statistics.read(performance.now() / 1e3, null, null, null);
  }

  /** Pixels of the pictures, from the next one that is drawn. */
  resize(width: number, height: number): void {
    this.#size = { width, height };
    if (!this.vr) this.#playback?.resize(width, height);
  }

  readonly #tell = (type: string, detail?: Problem | Blob): void => {
    this.dispatchEvent(new CustomEvent(type, { detail }));
  };
}

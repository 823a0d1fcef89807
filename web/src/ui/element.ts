// The element itself: attributes, properties, methods; one view at a time.
import type { PlayerLike, PlayerSettings } from "./desk.ts";
import { make } from "./dom.ts";
import { showTrouble } from "./shell.ts";
import STYLE from "./style.css";
import { type Owner, View } from "./view.ts";

/** Workers and servers, which import this with all the rest, have no elements. */
const Base = globalThis.HTMLElement ?? (class {} as typeof HTMLElement);

/** Attributes that properties of the same name reflect: those that are there or not, and texts with their defaults. */
const FLAGS = ["autoplay", "controls", "hash", "loop", "muted"] as const;
const TEXTS = { path: "", policy: "", poster: "", quality: "auto", split: "" };

/** An element with a player and its controls; a subclass says which player. */
export abstract class PlayerElement extends Base implements Owner {
  static readonly observedAttributes = ["budget", "view-region", "src", ...FLAGS, ...Object.keys(TEXTS)];
  declare autoplay: boolean;
  declare controls: boolean;
  declare hash: boolean;
  declare loop: boolean;
  declare muted: boolean;
  declare path: string;
  declare policy: string;
  declare poster: string;
  declare quality: string;
  declare split: string;
  readonly #root = this.attachShadow({ mode: "open", delegatesFocus: true });
  #view: View | null = null;
  #end = new AbortController();
  #volume = 1;

  abstract create(canvas: HTMLCanvasElement, settings: PlayerSettings): PlayerLike;

  lacks(): boolean {
    const known = typeof VideoDecoder !== "undefined" && typeof WebGL2RenderingContext !== "undefined";
    return !window.isSecureContext || !known;
  }

  connectedCallback(): void {
    if (!this.src) return;
    try {
      if (this.lacks()) this.#refuse(null);
      else this.#view = new View(this, this.#root);
    } catch (error) {
      this.#refuse(error);
    }
  }

  disconnectedCallback(): void {
    this.#view?.close();
    this.#view = null;
    this.#end.abort();
    this.#root.replaceChildren();
  }

  attributeChangedCallback(name: string, before: string | null, now: string | null): void {
    if (!this.isConnected || before === now) return;
    if (name === "loop" || name === "muted") this.#view?.apply({ [name]: this[name] });
    else if (name === "policy") this.#view?.apply(now ? { policy: now } : {});
    else if (name === "quality") this.#view?.apply({ quality: this.quality });
    else if (name === "view-region") this.#view?.apply({}, this.viewRegion === "free");
    else this.again();
  }

  again(): void {
    this.disconnectedCallback();
    this.connectedCallback();
  }

  get player(): ReturnType<this["create"]> | null {
    return (this.#view?.player as ReturnType<this["create"]>) ?? null;
  }

  play(): void {
    this.player?.play();
  }

  pause(): void {
    this.player?.pause();
  }

  seek(seconds: number): void {
    this.player?.seek(seconds);
  }

  get paused(): boolean {
    return this.player?.paused ?? true;
  }

  get ended(): boolean {
    return this.player?.ended ?? false;
  }

  get duration(): number {
    return this.player?.duration ?? 0;
  }

  get currentTime(): number {
    return this.player?.currentTime ?? 0;
  }

  set currentTime(seconds: number) {
    this.seek(seconds);
  }

  get volume(): number {
    return this.#volume;
  }

  set volume(volume: number) {
    this.#volume = volume;
    this.#view?.apply({ volume });
  }

  /** The moment that is shown, as text for an address; setting it goes there. */
  get at(): string {
    return this.#view?.at ?? "";
  }

  set at(text: string) {
    this.#view?.go(text);
  }

  get src(): string {
    const src = this.getAttribute("src");
    return src ? new URL(src, this.baseURI).href : "";
  }

  set src(src: string) {
    this.setAttribute("src", src);
  }

  get viewRegion(): "bounded" | "free" {
    return this.getAttribute("view-region") === "free" ? "free" : "bounded";
  }

  set viewRegion(viewRegion: "bounded" | "free") {
    this.setAttribute("view-region", viewRegion);
  }

  get settings(): PlayerSettings {
    const { loop, muted, volume, policy } = this;
    const budget = Number(this.getAttribute("budget") ?? Infinity);
    return { loop, muted, volume, budget, ...(policy ? { policy } : {}) };
  }

  #refuse(error: unknown): void {
    this.#end = new AbortController();
    const frame = make("div", { class: "frame broken" });
    this.#root.replaceChildren(make("style", {}, STYLE), frame);
    showTrouble(frame, error, { src: this.src, again: () => this.again(), signal: this.#end.signal });
  }
}

for (const name of FLAGS) {
  Object.defineProperty(PlayerElement.prototype, name, {
    get: function (this: HTMLElement) {
      return this.hasAttribute(name);
    },
    set: function (this: HTMLElement, there: boolean) {
      this.toggleAttribute(name, there);
    },
  });
}
for (const [name, otherwise] of Object.entries(TEXTS)) {
  Object.defineProperty(PlayerElement.prototype, name, {
    get: function (this: HTMLElement) {
      return this.getAttribute(name) || otherwise;
    },
    set: function (this: HTMLElement, text: string) {
      this.setAttribute(name, text);
    },
  });
}

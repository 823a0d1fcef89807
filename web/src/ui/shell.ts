// Everything that is on top of the picture, put together: it shows what the player says and hides when nobody needs it.
import type { Region } from "../format/types.ts";
import { Bar } from "./bar.ts";
import type { Desk } from "./desk.ts";
import { ICONS, icon, make, write } from "./dom.ts";
import type { Menu } from "./menu.ts";
import type { Panel } from "./panel.ts";
import STYLE from "./style.css";

const HIDE_MS = 2800;
const MISSING_MS = 7000;
const MISSING = "This part of the player cannot be fetched now.";

interface Parts {
  readonly menu: Menu;
  readonly panel: Panel;
  readonly more: More;
}

export interface Looks {
  readonly controls: boolean;
  readonly poster: string;
  readonly src: string;
}

function nameOf(src: string): string {
  const folder = new URL(src).pathname.replace(/\/*(airgs\.json|manifest\.mpd)?\/*$/, "");
  const last = folder.slice(folder.lastIndexOf("/") + 1);
  try {
    return decodeURIComponent(last).replace(/\.airgs$/, "");
  } catch {
    return last; // no text in UTF-8
  }
}

export class Shell {
  readonly frame: HTMLElement;
  readonly canvas = make("canvas", { part: "picture" });
  readonly scene: HTMLElement;
  readonly notes = new Notes();
  readonly bar: Bar;
  #parts: Parts | null = null;
  readonly #poster = make("div", { class: "poster", part: "poster" });
  readonly #big = make("button", { type: "button", class: "big", "aria-label": "Play" }, icon(ICONS.play));
  readonly #edge = make("div", { class: "edge" });
  readonly #help = make("span", { id: "help", hidden: true });
  /** There was neither a picture nor a trouble yet. */
  blank = true;
  #timer = 0;

  constructor(
    readonly desk: Desk,
    readonly looks: Looks,
    root: ShadowRoot,
    readonly added: (more: More) => void,
  ) {
    this.bar = new Bar(desk, (page, opener) => this.use(({ menu }) => menu.toggle(page, opener)));
    const view = { role: "application", "aria-label": "3D view", "aria-roledescription": "3D view" };
    const attributes = { tabindex: 0, "aria-describedby": "help", ...view };
    this.scene = make("div", { class: "scene", ...attributes }, this.canvas, this.#help);
    if (looks.poster) this.#dress(looks.poster);
    else this.#poster.append(nameOf(looks.src));
    const spinner = make("div", { class: "spinner", role: "progressbar", "aria-label": "Loading" });
    this.frame = make("div", { class: "frame waiting fresh" }, this.scene, this.#poster, this.#edge, spinner);
    this.frame.append(this.notes.node, ...(looks.controls ? [this.#big, this.bar.node] : []));
    root.replaceChildren(make("style", {}, STYLE), this.frame);
    this.#listen();
  }

  update(): void {
    const { player } = this.desk;
    const began = this.desk.still || !player.paused || player.currentTime !== 0 || this.#parts?.panel.open;
    this.frame.classList.toggle("fresh", !this.desk.ready || !began);
    this.bar.update();
    this.bar.info.ariaPressed = String(!!this.#parts?.panel.open);
    this.#parts?.panel.update();
    this.#parts?.menu.update();
  }

  /** Show all keys, or hide them. */
  toggleKeys(): void {
    const card = this.frame.querySelector(".keys");
    card?.remove();
    if (card) this.scene.focus();
    else
      this.use(({ more }) => {
        const made = more.keysCard(this.desk, () => this.toggleKeys());
        this.frame.append(made);
        made.focus();
      });
  }

  /** Does something with the menu or the panel of figures, as soon as they are there. */
  async use(act: (parts: Parts) => void): Promise<void> {
    if (this.#parts) return act(this.#parts);
    const more = await loadMore().catch(() => null);
    if (this.desk.signal.aborted) return;
    if (!more) return this.notes.show("more", MISSING, MISSING_MS);
    this.#parts ??= this.#add(more);
    act(this.#parts);
  }

  #add(more: More): Parts {
    const { Menu, Panel, STYLE, helpOf } = more;
    const [menu, panel] = [new Menu(this.desk), new Panel(this.desk)];
    const on = { signal: this.desk.signal };
    this.frame.append(make("style", {}, STYLE));
    if (this.looks.controls) this.frame.append(panel.node, menu.node);
    panel.close.addEventListener("click", () => this.desk.toggleInfo(), on);
    const leaveAll = () => {
      menu.close();
      this.frame.querySelector(".keys")?.remove();
    };
    this.scene.addEventListener("pointerdown", leaveAll, on);
    const leave = (event: KeyboardEvent) => {
      if (event.key !== "Escape") return;
      this.desk.toggleInfo();
      this.bar.info.focus();
    };
    panel.node.addEventListener("keydown", leave, on);
    write(this.#help, helpOf(this.desk));
    this.added(more);
    return { menu, panel, more };
  }

  /** How far a viewer pulls at the wall, 0 … 1. */
  set strain(strain: number) {
    this.#edge.style.opacity = strain > 0.02 ? strain.toFixed(2) : "0";
  }

  get waiting(): boolean {
    return this.frame.classList.contains("waiting");
  }

  set waiting(waiting: boolean) {
    this.frame.classList.toggle("waiting", waiting || this.blank);
  }

  /** The poster of the package, in place of its name. */
  showPoster(poster: Blob): void {
    if (!this.blank || this.#poster.style.background) return;
    const url = URL.createObjectURL(poster);
    this.desk.signal.addEventListener("abort", () => URL.revokeObjectURL(url));
    this.#dress(url);
  }

  #dress(url: string): void {
    this.#poster.replaceChildren();
    this.#poster.style.background = `#000 url(${JSON.stringify(url)}) center / auto min(100cqh, 100cqw * var(--tall, 1)) no-repeat`;
  }

  /** What the region of a package says of its poster, which is drawn at the height of the first picture. */
  set region({ width, height, background }: Region) {
    this.#poster.style.setProperty("--tall", String(Math.max(1, height / width)));
    const tint = (background ?? [0, 0, 0]).map((share) => Math.round(255 * share)).join(" ");
    if (this.#poster.style.background) this.#poster.style.backgroundColor = `rgb(${tint})`;
  }

  /** `begins`: the poster shows the same. */
  showPicture(begins: boolean): void {
    if (!begins) this.#poster.style.transition = "none";
    this.frame.classList.remove("broken");
    this.frame.querySelector(".card")?.remove();
    this.#poster.classList.add("gone");
    this.blank = false;
    this.waiting = false;
    this.stir();
    this.use(() => {});
  }

  showTrouble(error: unknown, again: () => void): void {
    this.blank = false;
    this.waiting = false;
    this.frame.classList.add("broken");
    showTrouble(this.frame, error, { src: this.looks.src, again, signal: this.desk.signal });
  }

  /** Whether nothing was played yet, and the large button is there. */
  get fresh(): boolean {
    return this.frame.classList.contains("fresh");
  }

  /** Somebody is there: show the controls, for a while. */
  stir(): void {
    window.clearTimeout(this.#timer);
    this.frame.classList.remove("idle");
    this.#timer = window.setTimeout(() => this.#hide(), HIDE_MS);
  }

  toggleControls(): void {
    if (this.frame.classList.contains("idle")) this.stir();
    else this.#hide();
  }

  close(): void {
    window.clearTimeout(this.#timer);
    this.notes.close();
  }

  #hide(): void {
    const busy = this.#parts?.menu.open || this.bar.timeline.scrubbing || this.bar.node.querySelector(":focus-visible");
    if ((this.desk.player.paused && !this.desk.still) || busy) this.stir();
    else this.frame.classList.add("idle");
  }

  #listen(): void {
    const on = { signal: this.desk.signal };
    const stir = (event: Event) => {
      const touch = event instanceof PointerEvent && event.pointerType === "touch";
      if (!touch || !this.scene.contains(event.target as Node)) this.stir();
    };
    for (const name of ["pointermove", "pointerdown", "keydown", "focusin"])
      this.frame.addEventListener(name, stir, on);
    this.frame.addEventListener("pointerleave", () => this.#hide(), on);
    this.#big.addEventListener("click", () => this.desk.toggle(), on);
  }
}

const FILLS = "fills-window";

/** Full screen; where a browser has none for elements (iPhone), the element fills the window instead. */
export class FullScreen {
  #overflow = "";

  constructor(
    readonly host: HTMLElement,
    changed: () => void,
    signal: AbortSignal,
  ) {
    document.addEventListener("fullscreenchange", changed, { signal });
    signal.addEventListener("abort", () => this.#fill(false));
  }

  get on(): boolean {
    const current = document.fullscreenElement;
    return this.host.hasAttribute(FILLS) || (!!current && (current === this.host || current.contains(this.host)));
  }

  async toggle(): Promise<void> {
    if (this.host.hasAttribute(FILLS)) this.#fill(false);
    else if (this.on) await document.exitFullscreen();
    else if (!this.host.requestFullscreen) this.#fill(true);
    else await this.host.requestFullscreen().catch(() => this.#fill(true)); // a frame without the permission
  }

  #fill(fills: boolean): void {
    if (this.host.hasAttribute(FILLS) === fills) return;
    this.host.toggleAttribute(FILLS, fills);
    const { style } = document.documentElement;
    if (fills) this.#overflow = style.overflow;
    style.overflow = fills ? "hidden" : this.#overflow;
  }
}

/** Notes above the controls, each with a name: a new one takes the place of the old. */
class Notes {
  readonly node = make("div", { class: "notes", role: "status", "aria-live": "polite" });
  readonly #timers = new Map<string, number>();

  /** `ms`: gone after that time; without: when it is taken back. */
  show(name: string, text: string, ms?: number): void {
    const old = this.#find(name);
    if (old) write(old, text);
    else this.node.append(make("div", { class: "note", "data-name": name }, text));
    this.#hideIn(name, ms);
  }

  hide(name: string, ms = 0): void {
    if (ms > 0) {
      if (this.#find(name) && !this.#timers.has(name)) this.#hideIn(name, ms);
      return;
    }
    this.#hideIn(name);
    this.#find(name)?.remove();
  }

  #hideIn(name: string, ms?: number): void {
    window.clearTimeout(this.#timers.get(name));
    this.#timers.delete(name);
    if (ms !== undefined) this.#timers.set(name, window.setTimeout(this.hide.bind(this), ms, name));
  }

  close(): void {
    for (const name of [...this.#timers.keys()]) this.hide(name);
  }

  #find(name: string): HTMLElement | null {
    return this.node.querySelector(`[data-name="${name}"]`);
  }
}

export type More = typeof import("../airgs-more.ts");

/** Throws TypeError where it cannot be fetched. */
export const loadMore = (): Promise<More> => import("../airgs-more.ts");

/** Says on a frame what went wrong with what is at `src`; null: what this browser lacks to play anything. */
export async function showTrouble(
  frame: HTMLElement,
  error: unknown,
  { src, again, signal }: { src: string; again: () => void; signal: AbortSignal },
): Promise<void> {
  const more = await loadMore().catch(() => null);
  if (signal.aborted || !frame.classList.contains("broken")) return; // meanwhile there is a picture
  frame.querySelector(".card")?.remove();
  if (!more) {
    frame.append(make("div", { class: "card", role: "alert" }, String(error ?? "This browser cannot play it.")));
    return;
  }
  const trouble = (error === null && more.lacking()) || more.troubleOf(error, src);
  frame.append(make("style", {}, more.STYLE), more.card(trouble, again, signal));
}

// Everything that is on top of the picture, put together: it shows what the player says and hides when nobody needs it.
import { Bar } from "./bar.ts";
import { card, Notes } from "./cards.ts";
import type { Desk } from "./desk.ts";
import { icon, make } from "./dom.ts";
import { HELP } from "./keys.ts";
import { Menu } from "./menu.ts";
import { Panel } from "./panel.ts";
import STYLE from "./style.css";
import type { Trouble } from "./trouble.ts";

const HIDE_MS = 2800;

export interface Looks {
  readonly controls: boolean;
  readonly poster: string | null;
  readonly src: string;
}

/** The name that people give a package: the last part of its address. */
function nameOf(src: string): string {
  const last = new URL(src).pathname.split("/").filter(Boolean).pop() ?? "";
  try {
    return decodeURIComponent(last).replace(/\.airgs$/, "");
  } catch {
    return last; // no text in UTF-8
  }
}

export class Shell {
  readonly frame: HTMLElement;
  readonly canvas = make("canvas", { part: "picture" });
  /** What is dragged and has the keyboard. */
  readonly scene: HTMLElement;
  readonly notes = new Notes();
  readonly menu: Menu;
  readonly panel: Panel;
  readonly bar: Bar;
  readonly #poster = make("div", { class: "poster", part: "poster" });
  readonly #big = make("button", { type: "button", class: "big", "aria-label": "Play" }, icon("play"));
  readonly #edge = make("div", { class: "edge" });
  #timer = 0;
  /** There is no picture yet. */
  #blank = true;

  constructor(
    readonly desk: Desk,
    looks: Looks,
    root: ShadowRoot,
  ) {
    this.menu = new Menu(desk);
    this.panel = new Panel(desk);
    this.bar = new Bar(desk, this.menu);
    const help = make("span", { id: "help", hidden: true }, HELP);
    const view = { role: "application", "aria-label": "3D view", "aria-roledescription": "3D view" };
    this.scene = make("div", { class: "scene", tabindex: 0, "aria-describedby": "help", ...view }, this.canvas, help);
    if (looks.poster)
      this.#poster.style.background = `#000 url(${JSON.stringify(looks.poster)}) center / contain no-repeat`;
    else this.#poster.append(nameOf(looks.src));
    const spinner = make("div", { class: "spinner", role: "progressbar", "aria-label": "Loading" });
    const above = looks.controls ? [this.#big, this.bar.node, this.panel.node, this.menu.node] : [];
    this.frame = make(
      "div",
      { class: "frame waiting fresh" },
      this.scene,
      this.#poster,
      this.#edge,
      spinner,
      this.notes.node,
    );
    this.frame.append(...above);
    root.replaceChildren(make("style", {}, STYLE), this.frame);
    this.#listen();
  }

  update(): void {
    const { player } = this.desk;
    this.frame.classList.toggle(
      "fresh",
      !this.desk.ready || (player.paused && player.currentTime === 0 && !this.panel.open),
    );
    this.bar.update();
    this.bar.info.ariaPressed = String(this.panel.open);
    this.panel.update();
  }

  /** How far a viewer pulls at the wall, 0 … 1. */
  set strain(strain: number) {
    this.#edge.style.opacity = strain > 0.02 ? strain.toFixed(2) : "0";
  }

  get waiting(): boolean {
    return this.frame.classList.contains("waiting");
  }

  /** The spinner, after a while. */
  set waiting(waiting: boolean) {
    this.frame.classList.toggle("waiting", waiting || this.#blank);
  }

  showPicture(): void {
    this.#poster.classList.add("gone");
    this.#blank = false;
    this.waiting = false;
    this.stir();
  }

  /** Nothing can be played: say why. */
  showTrouble(trouble: Trouble, again: () => void): void {
    this.#blank = false;
    this.waiting = false;
    this.frame.classList.add("broken");
    this.frame.querySelector(".card")?.remove();
    this.frame.append(card(trouble, again, this.desk.signal));
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

  /** Hide the controls, unless somebody uses them. */
  #hide(): void {
    const busy = this.menu.open || this.bar.timeline.scrubbing || this.bar.node.querySelector(":focus-visible");
    if (this.desk.player.paused || busy) this.stir();
    else this.frame.classList.add("idle");
  }

  #listen(): void {
    const on = { signal: this.desk.signal };
    const stir = (event: Event) => {
      if (
        !(event instanceof PointerEvent && event.pointerType === "touch" && this.scene.contains(event.target as Node))
      )
        this.stir();
    };
    for (const name of ["pointermove", "pointerdown", "keydown", "focusin"])
      this.frame.addEventListener(name, stir, on);
    this.frame.addEventListener("pointerleave", () => this.#hide(), on);
    this.#big.addEventListener("click", () => this.desk.toggle(), on);
    this.panel.close.addEventListener("click", () => this.desk.toggleInfo(), on);
    this.scene.addEventListener("pointerdown", () => this.menu.close(), on);
    this.panel.node.addEventListener(
      "keydown",
      (event) => {
        if (event.key !== "Escape") return;
        this.desk.toggleInfo();
        this.bar.info.focus();
      },
      on,
    );
  }
}

/** The attribute of an element that fills the window. */
const FILLS = "fills-window";

/** Full screen; where a browser has none for elements (iPhone), the element fills the window instead. Browsers with
 * WebCodecs need no prefixes.
 */
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

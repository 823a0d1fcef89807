// Full screen; where a browser has none for elements (iPhone), the element fills the window instead.

interface Webkit extends HTMLElement {
  webkitRequestFullscreen?(): void;
}
interface WebkitDocument extends Document {
  webkitFullscreenElement?: Element | null;
  webkitExitFullscreen?(): void;
}

/** The attribute of an element that fills the window. */
const FILLS = "fills-window";
const CHANGES = ["fullscreenchange", "webkitfullscreenchange"];

export class FullScreen {
  #overflow = "";

  constructor(
    readonly host: HTMLElement,
    changed: () => void,
    signal: AbortSignal,
  ) {
    for (const name of CHANGES) document.addEventListener(name, changed, { signal });
    signal.addEventListener("abort", () => this.#fill(false));
  }

  get on(): boolean {
    const current = document.fullscreenElement ?? (document as WebkitDocument).webkitFullscreenElement;
    return this.host.hasAttribute(FILLS) || (!!current && (current === this.host || current.contains(this.host)));
  }

  async toggle(): Promise<void> {
    if (this.host.hasAttribute(FILLS)) this.#fill(false);
    else if (this.on) await this.#exit();
    else await this.#enter();
  }

  async #enter(): Promise<void> {
    const host: Webkit = this.host;
    try {
      if (host.requestFullscreen) await host.requestFullscreen();
      else if (host.webkitRequestFullscreen) host.webkitRequestFullscreen();
      else this.#fill(true);
    } catch {
      this.#fill(true); // a frame without the permission
    }
  }

  async #exit(): Promise<void> {
    if (document.exitFullscreen) await document.exitFullscreen();
    else (document as WebkitDocument).webkitExitFullscreen?.();
  }

  #fill(fills: boolean): void {
    if (this.host.hasAttribute(FILLS) === fills) return;
    this.host.toggleAttribute(FILLS, fills);
    const { style } = document.documentElement;
    if (fills) this.#overflow = style.overflow;
    style.overflow = fills ? "hidden" : this.#overflow;
  }
}

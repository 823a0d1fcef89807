// Full screen; where a browser has none for elements (iPhone), the element fills the window instead. Browsers with
// WebCodecs need no prefixes.

/** The attribute of an element that fills the window. */
const FILLS = "fills-window";

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

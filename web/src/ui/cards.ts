// What the element says: cards that stand in the way because nothing can be played, and notes that pass.
import { icon, make, write } from "./dom.ts";
import type { Trouble } from "./trouble.ts";

const COPIED_MS = 2000;

/** A card with a trouble; `again` is called when people want to try again. */
export function card(trouble: Trouble, again: () => void, signal: AbortSignal): HTMLElement {
  const copy = make("button", { type: "button" }, "Copy details");
  const buttons = make("div", { class: "buttons" }, copy);
  copy.addEventListener("click", () => copyText(copy, trouble.details), { signal });
  if (trouble.again) {
    const retry = make("button", { type: "button", class: "main" }, "Try again");
    retry.addEventListener("click", again, { signal });
    buttons.prepend(retry);
  }
  return make(
    "div",
    { class: "card", part: "card", role: "alert" },
    icon(trouble.icon),
    make("h2", {}, trouble.title),
    make("p", {}, trouble.text),
    buttons,
  );
}

async function copyText(button: HTMLButtonElement, text: string): Promise<void> {
  try {
    await navigator.clipboard.writeText(text);
    write(button, "Copied");
    window.setTimeout(() => write(button, "Copy details"), COPIED_MS);
  } catch {
    // Not allowed, or no clipboard: then people can select it.
    button.replaceWith(make("pre", { tabindex: 0 }, text));
  }
}

/** Notes above the controls, each with a name: a new one takes the place of the old. */
export class Notes {
  readonly node = make("div", { class: "notes", role: "status", "aria-live": "polite" });
  readonly #timers = new Map<string, number>();

  /** `ms`: gone after that time; without: when it is taken back. */
  show(name: string, text: string, ms?: number): void {
    const old = this.#find(name);
    if (old) write(old, text);
    else this.node.append(make("div", { class: "note", "data-name": name }, text));
    this.#hideIn(name, ms);
  }

  /** At once, or in a while unless it is shown again. */
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

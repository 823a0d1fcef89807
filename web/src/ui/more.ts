// What is loaded when somebody needs it: parts of airgs-more.js, which is beside this script.
import { make } from "./dom.ts";

const MORE = "./airgs-more.js";

export type More = typeof import("../airgs-more.ts");

/** Throws TypeError where it cannot be fetched. */
export const loadMore = (): Promise<More> => import(new URL(MORE, import.meta.url).href);

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

// What is loaded when somebody needs it: parts of airgs-more.js, which is beside this script.
import type { Vector } from "../format/vector.ts";
import type { CameraPath } from "../play/keyframes.ts";
import { make } from "./dom.ts";

const MORE = "./airgs-more.js";
/** A player waits no longer for a path. */
const LONGEST_MS = 5000;

export type More = typeof import("../airgs-more.ts");

/** Throws TypeError where it cannot be fetched. */
export const loadMore = (): Promise<More> => import(new URL(MORE, import.meta.url).href);

/** A function that reads the camera path at an address, given what is up and the field of view where it says neither.
 *
 * Throws TypeError or SyntaxError where there is none, and the function Error.
 */
export async function loadPath(address: string): Promise<(up: Vector, fovY: number) => CameraPath> {
  const asked = fetch(address, { signal: AbortSignal.timeout(LONGEST_MS) }).then((response) => {
    if (!response.ok) throw new TypeError(`${address}: HTTP ${response.status}`);
    return response.json();
  });
  const [data, more] = await Promise.all([asked, loadMore()]);
  return (up, fovY) => more.readCameraPath(data, up, fovY);
}

/** Says on a frame what went wrong with what is at `src`; null: what this browser lacks to play anything. */
export async function showTrouble(
  frame: HTMLElement,
  error: unknown,
  { src, again, signal }: { src: string; again: () => void; signal: AbortSignal },
): Promise<void> {
  const more = await loadMore().catch(() => null);
  if (signal.aborted) return;
  frame.querySelector(".card")?.remove();
  if (!more) {
    frame.append(make("div", { class: "card", role: "alert" }, String(error ?? "This browser cannot play it.")));
    return;
  }
  const trouble = (error === null && more.lacking()) || more.troubleOf(error, src);
  frame.append(make("style", {}, more.STYLE), more.card(trouble, again, signal));
}

// What is loaded when somebody needs it: parts of airgs-more.js, which is beside this script.
import type { Vector } from "../format/vector.ts";
import type { CameraPath, readCameraPath } from "../play/keyframes.ts";
import type { Menu } from "./menu.ts";
import type { Panel } from "./panel.ts";
import type { Split } from "./split.ts";

const MORE = "./airgs-more.js";
/** A player waits no longer for a path. */
const LONGEST_MS = 5000;

export interface More {
  readCameraPath: typeof readCameraPath;
  Menu: typeof Menu;
  Panel: typeof Panel;
  Split: typeof Split;
  /** Of these three. */
  STYLE: string;
}

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

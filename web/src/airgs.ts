// The player as a module, without controls: docs/browser.md.
import type { PlayerOptions } from "./play/playback.ts";
import { Player } from "./play/player.ts";

export { FormatError, type Reason } from "./format/errors.ts";
export type { ViewState } from "./format/region.ts";
export type { Place, Region, Root, World } from "./format/types.ts";
export { TransportError, UnsupportedError } from "./media/errors.ts";
export type { PlayerOptions, Problem } from "./play/playback.ts";
export { Player } from "./play/player.ts";
export type { PlayerStats } from "./play/statistics.ts";

/** Opens a package for a canvas. Nothing moves until `play`. Throws what `Player.open` does. */
export async function open(canvas: HTMLCanvasElement, src: string, options: PlayerOptions = {}): Promise<Player> {
  const player = new Player(canvas, options);
  try {
    await player.open(src);
  } catch (error) {
    player.close();
    throw error;
  }
  return player;
}

// Frames of packages as Gaussians, without a player:
//
//     import { openFrames } from "./airgs-frames.js";
//     const reader = await openFrames("https://example.org/fox.airgs/");
//     const { means, quaternions, logScales, alpha, colours } = await reader.gaussians(0);
import { FrameReader } from "./frames.ts";

export { FormatError, type Reason } from "./format/errors.ts";
export type { Gaussians, Place, Region, Root, World } from "./format/types.ts";
export { TransportError, UnsupportedError } from "./media/errors.ts";
export { FrameReader };

/** Opens a package to read its frames as Gaussians. Throws what `Player.open` does. */
export function openFrames(src: string): Promise<FrameReader> {
  return FrameReader.open(src);
}

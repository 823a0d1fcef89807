// What the shaders need to know of an atlas to read codes: see CODES in shaders.ts.
import { planeCorner } from "../format/atlas.ts";
import type { Atlas } from "../format/types.ts";
import { BLOCK } from "../generated/constants.ts";

/** Uniforms of an atlas. C colour channels, of which T may differ from 0. */
export interface CodeTable {
  /** Blocks side by side in a plane, lines of a picture; never 0. */
  layout: [number, number];
  /** (4 · channels before colour) x and y of the plane's corner, x -1 without a plane; centre; bits of the step. */
  entries: Int32Array;
  /** (4 T) the same of colour channels. */
  tints: Int32Array;
  /** (T) which colour channel each is. */
  tintChannels: Int32Array;
}

/** `steps`: value of a code of every channel; those from `firstColour` on are of colours. */
export function codeTable(atlas: Atlas, steps: Float32Array, firstColour: number): CodeTable {
  const { centres, planes } = atlas;
  const all = new Int32Array(4 * centres.length);
  const bits = new Int32Array(steps.buffer, steps.byteOffset, steps.length);
  centres.forEach((centre, channel) => {
    all.set([-1, 0, centre, bits[channel]], 4 * channel);
  });
  planes.forEach((channel, plane) => {
    const corner = planeCorner(atlas, plane);
    all.set([corner % atlas.width, Math.floor(corner / atlas.width)], 4 * channel);
  });
  const colours = centres.map((_, channel) => channel).slice(firstColour);
  const drawn = colours.filter((channel) => all[4 * channel] >= 0 || centres[channel] !== 0);
  return {
    layout: [Math.max(1, atlas.plane_width / BLOCK), Math.max(1, atlas.height)],
    entries: all.slice(0, 4 * firstColour),
    tints: Int32Array.from(drawn.flatMap((channel) => Array.from(all.subarray(4 * channel, 4 * channel + 4)))),
    tintChannels: Int32Array.from(drawn, (channel) => channel - firstColour),
  };
}

// Where samples lie in pictures: FORMAT.md, section 4. N rows, P planes.
import { BLOCK, ESCAPE_UNIT, GREY } from "../generated/constants.ts";
import { FormatError } from "./errors.ts";
import type { Atlas, BaseChanges } from "./types.ts";

const CELLS = BLOCK * BLOCK;

export function planeHeight(rows: number, planeWidth: number): number {
  return BLOCK * Math.ceil((Math.ceil(rows / CELLS) * BLOCK) / planeWidth);
}

/** How many pictures show an atlas together, each the next `height` lines; 0 without planes. */
export function pages({ rows, planes, plane_width, columns, height }: Atlas): number {
  if (!planes.length) return 0;
  return Math.ceil((planeHeight(rows, plane_width) * Math.ceil(planes.length / columns)) / height);
}

export function atlasSamples(atlas: Atlas): number {
  return pages(atlas) * atlas.width * atlas.height;
}

/** The even bits of a number of 8 bits, next to each other. */
const evenBits = (cell: number) => (cell & 1) | ((cell >> 1) & 2) | ((cell >> 2) & 4) | ((cell >> 3) & 8);

/** (N) places of the samples of rows, from the corner of their plane on, in an atlas: line · width + column. */
export function rowOffsets(atlas: Atlas): Uint32Array {
  const blocks = atlas.plane_width / BLOCK;
  const offsets = new Uint32Array(atlas.planes.length ? atlas.rows : 0);
  const cells = Uint32Array.from({ length: CELLS }, (_, cell) => evenBits(cell >> 1) * atlas.width + evenBits(cell));
  for (let first = 0, block = 0; first < offsets.length; first += CELLS, block++) {
    const corner = BLOCK * (Math.floor(block / blocks) * atlas.width + (block % blocks));
    const count = Math.min(CELLS, offsets.length - first);
    for (let cell = 0; cell < count; cell++) offsets[first + cell] = corner + cells[cell]!;
  }
  return offsets;
}

export function planeCorner(atlas: Atlas, plane: number): number {
  const line = Math.floor(plane / atlas.columns) * planeHeight(atlas.rows, atlas.plane_width);
  return line * atlas.width + (plane % atlas.columns) * atlas.plane_width;
}

/** What a byte makes of a checksum; from 256, 512 and 768 on: with one, two and three bytes after it. */
const CRC = new Int32Array(4 * 256);
for (let n = 0; n < CRC.length; n++) {
  let rest = n < 256 ? n : CRC[n - 256]!;
  for (let bit = 0; bit < 8; bit++) rest = rest & 1 ? (rest >>> 1) ^ 0xedb88320 : rest >>> 1;
  CRC[n] = rest;
}

/** Throws FormatError(bad_picture) unless decoded luma has this checksum, CRC-32 (RFC 1952); `where` names the file. */
export function checkLuma(luma: Uint8Array, checksum: number | undefined, where: string): void {
  let rest = -1;
  let i = 0;
  for (; i < luma.length - 3; i += 4) {
    rest ^= luma[i]! | (luma[i + 1]! << 8) | (luma[i + 2]! << 16) | (luma[i + 3]! << 24);
    const after = CRC[768 + (rest & 255)]! ^ CRC[512 + ((rest >>> 8) & 255)]!;
    rest = after ^ CRC[256 + ((rest >>> 16) & 255)]! ^ CRC[rest >>> 24]!;
  }
  for (; i < luma.length; i++) rest = (rest >>> 8) ^ CRC[(rest ^ luma[i]!) & 255]!;
  if (~rest >>> 0 !== checksum)
    throw new FormatError("bad_picture", where, `a picture differs from its checksum ${checksum}`);
}

/** (`samples`) bases after changes from bases of 0, one after the other; null where there is no change. */
export function basesAfter(samples: number, changes: readonly (BaseChanges | null)[]): Int32Array | null {
  if (!changes.some((one) => one)) return null;
  const bases = new Int32Array(samples);
  for (const one of changes) {
    one?.texels.forEach((texel, i) => {
      bases[texel] = one.bases[i]!;
    });
  }
  return bases;
}

/** (samples) codes of slopes, from their picture. */
export function slopeCodes(luma: Uint8Array, bases: BaseChanges | null): Int32Array {
  const slopes = Int32Array.from(luma, (sample) => sample - GREY);
  bases?.texels.forEach((texel, i) => {
    slopes[texel]! += ESCAPE_UNIT * bases.bases[i]!;
  });
  return slopes;
}

/** (channels · N) luma − GREY + ESCAPE_UNIT · base + centre of every channel, and what slopes add at a `time`; `bases`
 * null: they are 0.
 */
export function readCodes(
  atlas: Atlas,
  luma: Uint8Array,
  bases: Int32Array | null,
  slopes: Int32Array | null = null,
  time = 0,
): Int32Array | Float64Array {
  const { rows, centres, planes } = atlas;
  const codes = new (slopes ? Float64Array : Int32Array)(centres.length * rows);
  centres.forEach((centre, channel) => {
    codes.fill(centre, channel * rows, (channel + 1) * rows);
  });
  const offsets = rowOffsets(atlas);
  planes.forEach((channel, plane) => {
    const corner = planeCorner(atlas, plane);
    for (let i = 0; i < rows; i++) {
      const place = corner + offsets[i]!;
      codes[channel * rows + i]! +=
        luma[place]! - GREY + (bases ? ESCAPE_UNIT * bases[place]! : 0) + (slopes ? time * slopes[place]! : 0);
    }
  });
  return codes;
}

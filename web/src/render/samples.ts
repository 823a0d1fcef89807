// The samples of an atlas on the GPU: luma, a layer a page, and bases where any is not 0 (FORMAT.md, sections 4 and 6);
// and what the shaders need to know of an atlas to read codes: see CODES in shaders.ts.
import { pages, planeCorner } from "../format/atlas.ts";
import type { Atlas, BaseChanges } from "../format/types.ts";
import { BLOCK } from "../generated/constants.ts";
import { RenderError, type Texture, texture, write } from "./textures.ts";

/** Bases and slopes, two numbers a sample, go to the GPU with `upload`, in strips of 16 lines: few change a frame. */
export class Samples {
  readonly #width: number;
  readonly #height: number;
  readonly #pages: number;
  readonly luma: Texture;
  bases: Texture | null = null;
  #all: Int32Array | null = null;
  /** Strips of which a sample may have another base or slope than 0. */
  readonly #used = new Set<number>();
  /** Strips that the GPU does not have yet. */
  readonly #changed = new Set<number>();

  constructor(
    private readonly gl: WebGL2RenderingContext,
    atlas: Atlas,
  ) {
    this.#pages = pages(atlas);
    [this.#width, this.#height] = this.#pages ? [atlas.width, atlas.height] : [1, 1];
    const most: number | null = gl.getParameter(gl.MAX_ARRAY_TEXTURE_LAYERS); // null: the context was lost
    if (most !== null && this.#pages > most)
      throw new RenderError(`an atlas: expected at most ${most} pages, got ${this.#pages}`);
    this.luma = texture(gl, "R8UI", [this.#width, this.#height], Math.max(1, this.#pages));
  }

  setLuma(luma: Uint8Array): void {
    const page = this.#width * this.#height;
    if (luma.length !== this.#pages * page) {
      throw new RenderError(`luma: expected ${this.#pages * page} samples, got ${luma.length}`);
    }
    for (let layer = 0; layer < this.#pages; layer++) {
      write(this.gl, this.luma, { y: 0, width: this.#width, height: this.#height, layer }, luma, layer * page);
    }
  }

  change({ texels, bases, slopes }: BaseChanges): void {
    this.#all ??= new Int32Array(2 * this.#pages * this.#height * this.#width);
    const all = this.#all;
    const mark = (texel: number) => {
      const n = Math.floor(texel / BLOCK / this.#width);
      for (const strips of [this.#used, this.#changed]) strips.add(n);
    };
    slopes?.forEach((slope, i) => {
      all[2 * i + 1] = slope;
      if (i % this.#width === 0) mark(i);
    });
    texels.forEach((texel, i) => {
      all[2 * texel] = bases[i];
      mark(texel);
    });
  }

  reset(): void {
    const strip = 2 * BLOCK * this.#width;
    for (const n of this.#used) {
      this.#all!.fill(0, n * strip, (n + 1) * strip);
      this.#changed.add(n);
    }
    this.#used.clear();
  }

  upload(): void {
    if (!this.#all) return;
    this.bases ??= texture(this.gl, "RG32I", [this.#width, this.#height], this.#pages);
    const strips = this.#height / BLOCK;
    for (const first of [...this.#changed].sort((a, b) => a - b)) {
      const layer = Math.floor(first / strips);
      let next = first; // those of one run go together
      while (next < (layer + 1) * strips && this.#changed.delete(next)) next++;
      const box = { y: (first % strips) * BLOCK, width: this.#width, height: (next - first) * BLOCK, layer };
      if (box.height) write(this.gl, this.bases, box, this.#all, 2 * first * BLOCK * this.#width);
    }
  }

  free(): void {
    this.gl.deleteTexture(this.luma.handle);
    if (this.bases) this.gl.deleteTexture(this.bases.handle);
  }
}

/** Uniforms of an atlas. C colour channels, of which T may differ from 0. */
export interface CodeTable {
  /** Blocks side by side in a plane, lines of a picture; never 0. */
  layout: [number, number];
  /** (4 · channels before colour) x and y of the plane's corner, x -1 without a plane; centre; bits of the step. */
  entries: Int32Array;
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

// The pictures of an .m4s file, put together from their pages: FORMAT.md, sections 2 and 4.
import { atlasSamples, checkLuma } from "../format/atlas.ts";
import { FormatError } from "../format/errors.ts";
import type { Sample } from "../format/mp4.ts";
import type { Atlas } from "../format/types.ts";
import { type DecodeOptions, LumaDecoder, readLuma, type Samples } from "./decoder.ts";
import type { Probe } from "./probe.ts";

export interface PictureFile {
  pages: Sample[][];
  checksums: Uint32Array;
  atlas: Atlas;
  frames: number;
  where: string;
}

/** Decodes files of pictures one after the other, by what a probe of the browser found. */
export class PictureDecoder {
  readonly #decoder: LumaDecoder;

  constructor(readonly probe: Probe) {
    this.#decoder = new LumaDecoder(probe.acceleration);
  }

  /** Decodes a file, and gives the samples of each picture `t`, its pages one after the other, when the last is there.
   *
   * Of pictures before `first` it gives no samples. Throws FormatError(bad_picture) for pictures of another number or
   * size, or whose luma differs from its checksum.
   */
  async decode(
    file: PictureFile,
    take: (t: number, luma: Uint8Array) => void,
    { first = 0, ...options }: DecodeOptions = {},
  ): Promise<void> {
    const { atlas, frames, pages, checksums, where } = file;
    const { width, height } = atlas;
    const gathered = new Map<number, Uint8Array>();
    /** Pages come as all of the first, then all of the next. */
    const gather = (samples: Samples, n: number) => {
      const t = n % frames;
      const page = Math.floor(n / frames);
      if (t < first) return page ? undefined : take(t, new Uint8Array());
      const luma = gathered.get(t) ?? new Uint8Array(atlasSamples(atlas));
      const part = luma.subarray(page * width * height, (page + 1) * width * height);
      readLuma(samples, width, height, this.probe.inverses, part);
      checkLuma(part, checksums[n], where);
      gathered.set(t, luma);
      if (page < pages.length - 1) return;
      gathered.delete(t);
      take(t, luma);
    };
    const got = await this.#decoder.decode({ samples: pages.flat(), width, height, where }, gather, options);
    const expected = pages.length * frames;
    if (got !== expected) throw new FormatError("bad_picture", where, `expected ${expected} pictures, got ${got}`);
  }
}

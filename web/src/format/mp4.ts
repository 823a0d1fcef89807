// Media segments: FORMAT.md, section 2. Boxes are those of ISO/IEC 14496-12 (8.8: fragments), with sizes of 32 bits.
import { BOX_HEADER, OWN_UUID, TFHD, TRUN } from "../generated/constants.ts";
import { FormatError } from "./errors.ts";

export interface Sample {
  /** NAL units, each after its length in 4 bytes. */
  data: Uint8Array;
  time: number;
  duration: number;
}

export interface Media {
  /** Of the luma of as many pictures as there are samples, each page in display order. */
  checksums: Uint32Array;
  /** A column file; null: there is none, every number in it is 0. */
  columns: Uint8Array | null;
  samples: Sample[];
}

interface Box {
  kind: string;
  start: number;
  stop: number;
}

const UUID_BYTES = 16;
const HAS_FLAGS = 0x400; // of a trun box, 8.8.8: the flags of each sample, which are not read

/** The parts of a media segment; `where` names the file. Throws FormatError(bad_picture). */
export function readMedia(data: Uint8Array, where: string): Media {
  return new Reader(data, where).media();
}

/** The samples of a media segment without a uuid box. Throws FormatError(bad_sound). */
export function readPackets(data: Uint8Array, where: string): Sample[] {
  return new Reader(data, where, "bad_sound").packets();
}

class Reader {
  #view: DataView;

  constructor(
    readonly data: Uint8Array,
    readonly where: string,
    readonly reason: "bad_picture" | "bad_sound" = "bad_picture",
  ) {
    this.#view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  }

  media(): Media {
    const [own, moof, mdat] = this.#expect("uuid moof mdat") as [Box, Box, Box];
    const samples = this.#samples(moof, mdat);
    const type = [...this.data.subarray(own.start, Math.min(own.start + UUID_BYTES, own.stop))];
    const text = type.map((byte) => byte.toString(16).padStart(2, "0")).join("");
    if (text !== OWN_UUID) throw this.#bad(`expected the uuid ${OWN_UUID}, got ${text}`);
    const columns = own.start + UUID_BYTES + 4 * samples.length;
    if (columns > own.stop) throw this.#bad(`expected ${samples.length} checksums, got ${own.stop - own.start} bytes`);
    const checksums = Uint32Array.from(samples, (_, n) => this.#view.getUint32(columns - 4 * (samples.length - n)));
    return { checksums, columns: columns < own.stop ? this.data.subarray(columns, own.stop) : null, samples };
  }

  packets(): Sample[] {
    const [moof, mdat] = this.#expect("moof mdat");
    return this.#samples(moof!, mdat!);
  }

  #expect(kinds: string): Box[] {
    const boxes = this.#boxes(0, this.data.length);
    const got = boxes.map((box) => box.kind).join(" ");
    if (got !== kinds) throw this.#bad(`expected the boxes ${kinds}, got ${got.slice(0, 80)}`);
    return boxes;
  }

  #samples(moof: Box, mdat: Box): Sample[] {
    this.#child(moof, "mfhd");
    const traf = this.#child(moof, "traf");
    const defaults = this.#defaults(this.#child(traf, "tfhd"));
    const samples: Sample[] = [];
    const tfdt = this.#child(traf, "tfdt");
    const long = this.#u32(tfdt, 0) >>> 24 === 1;
    let time = long ? this.#u32(tfdt, 4) * 2 ** 32 + this.#u32(tfdt, 8) : this.#u32(tfdt, 4);
    let at = mdat.start;
    for (const { duration, size, offset } of this.#run(this.#child(traf, "trun"), moof, defaults)) {
      if (size <= 0 || size > mdat.stop - at) {
        throw this.#bad(`sample ${samples.length} of ${size} bytes at ${at} of ${mdat.stop}`);
      }
      samples.push({ data: this.data.subarray(at, at + size), time: time + offset, duration });
      at += size;
      time += duration;
    }
    return samples;
  }

  /** The default duration and size of samples, 0 where there is none. */
  #defaults(tfhd: Box): { duration: number; size: number } {
    const flags = this.#u32(tfhd, 0);
    let at = 8 + (flags & TFHD.base ? 8 : 0) + (flags & TFHD.description ? 4 : 0);
    const duration = flags & TFHD.duration ? this.#u32(tfhd, at) : 0;
    at += flags & TFHD.duration ? 4 : 0;
    return { duration, size: flags & TFHD.size ? this.#u32(tfhd, at) : 0 };
  }

  *#run(trun: Box, moof: Box, defaults: { duration: number; size: number }) {
    const flags = this.#u32(trun, 0);
    const count = this.#u32(trun, 4);
    const expected = moof.stop - moof.start + 2 * BOX_HEADER;
    if (!(flags & TRUN.offset) || this.#u32(trun, 8) !== expected)
      throw this.#bad("the samples do not follow the moof");
    let at = 12 + (flags & TRUN.first ? 4 : 0);
    const next = (flag: number, missing: number) => {
      if (!(flags & flag)) return missing;
      at += 4;
      return this.#u32(trun, at - 4);
    };
    for (let i = 0; i < count; i++) {
      const duration = next(TRUN.duration, defaults.duration);
      const size = next(TRUN.size, defaults.size);
      next(HAS_FLAGS, 0);
      const offset = next(TRUN.composition, 0);
      yield { duration, size, offset: flags >>> 24 ? offset | 0 : offset };
    }
  }

  #child(parent: Box, kind: string): Box {
    const found = this.#boxes(parent.start, parent.stop).filter((box) => box.kind === kind);
    if (found.length !== 1) throw this.#bad(`expected one box ${kind}, got ${found.length}`);
    return found[0]!;
  }

  #boxes(start: number, stop: number): Box[] {
    const boxes: Box[] = [];
    for (let at = start; at < stop; ) {
      const size = stop - at < BOX_HEADER ? 0 : this.#view.getUint32(at);
      if (size < BOX_HEADER || size > stop - at) throw this.#bad(`a box of ${size} bytes at ${at} of ${stop}`);
      const kind = String.fromCharCode(...this.data.subarray(at + 4, at + BOX_HEADER));
      boxes.push({ kind, start: at + BOX_HEADER, stop: at + size });
      at += size;
    }
    return boxes;
  }

  #u32({ kind, start, stop }: Box, at: number): number {
    if (start + at + 4 > stop) throw this.#bad(`a box ${kind} ends after ${stop - start} bytes`);
    return this.#view.getUint32(start + at);
  }

  #bad(detail: string): FormatError {
    return new FormatError(this.reason, this.where, detail);
  }
}

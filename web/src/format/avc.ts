// H.264 as far as a reader needs it without decoding: ISO/IEC 14496-10, NAL units (7.3.1) and SPS (7.3.2.1).
import { atlasLines, pages } from "./atlas.ts";
import { FormatError } from "./errors.ts";
import type { Sample } from "./mp4.ts";
import type { Atlas } from "./types.ts";

export interface Parameters {
  /** RFC 6381, for decoders that are configured without a description and take Annex B. */
  codec: string;
  /** Samples of luma after cropping. */
  width: number;
  height: number;
}

const IDR = 5;
const SPS = 7;
// Profiles whose SPS says which chroma and depths it has: 7.3.2.1.1.
const HIGH = [100, 110, 122, 244, 44, 83, 86, 118, 128, 138, 139, 134, 135];

export function nalUnits(sample: Uint8Array, where: string): Uint8Array[] {
  const view = new DataView(sample.buffer, sample.byteOffset, sample.byteLength);
  const units: Uint8Array[] = [];
  for (let at = 0; at < sample.length; ) {
    const size = sample.length - at < 4 ? 0 : view.getUint32(at);
    if (!size || size > sample.length - at - 4) {
      throw new FormatError("bad_picture", where, `a NAL unit of ${size} bytes at ${at} of ${sample.length}`);
    }
    units.push(sample.subarray(at + 4, at + 4 + size));
    at += 4 + size;
  }
  return units;
}

/** A sample with a start code 00000001 in place of every length. Throws FormatError(bad_picture). */
export function annexB(sample: Uint8Array, where: string): Uint8Array {
  const stream = sample.slice();
  for (const unit of nalUnits(sample, where)) stream.set([0, 0, 0, 1], unit.byteOffset - sample.byteOffset - 4);
  return stream;
}

export function isIdr(sample: Uint8Array, where: string): boolean {
  return nalUnits(sample, where).some((unit) => (unit[0]! & 31) === IDR);
}

/** The SPS in band of a sample. Throws FormatError(bad_picture) where there is none, or not of 8-bit 4:2:0. */
export function readParameters(sample: Uint8Array, where: string): Parameters {
  const unit = nalUnits(sample, where).find((unit) => (unit[0]! & 31) === SPS);
  if (!unit) throw new FormatError("bad_picture", where, "expected a sequence parameter set before the IDR picture");
  const bits = new Bits(unit, where);
  bits.read(8);
  const [profile, constraints, level] = [bits.read(8), bits.read(8), bits.read(8)];
  const codec = [profile, constraints, level].map((byte) => byte.toString(16).padStart(2, "0")).join("");
  bits.ue(); // seq_parameter_set_id
  if (HIGH.includes(profile)) skipHigh(bits);
  bits.ue(); // log2_max_frame_num_minus4
  skipOrder(bits);
  bits.ue(); // max_num_ref_frames
  bits.read(1);
  const wide = bits.ue() + 1;
  const units = bits.ue() + 1;
  const frameOnly = bits.read(1);
  if (!frameOnly) bits.read(1);
  bits.read(1); // direct_8x8_inference_flag
  const [left, right, top, bottom] = bits.read(1) ? [bits.ue(), bits.ue(), bits.ue(), bits.ue()] : [0, 0, 0, 0];
  const width = 16 * wide - 2 * (left + right);
  const height = (2 - frameOnly) * (16 * units - 2 * (top + bottom));
  return { codec: `avc1.${codec.toUpperCase()}`, width, height };
}

/** The samples of each page of `frames` pictures of an atlas, in decoding order.
 *
 * Throws FormatError(bad_picture) unless there are as many as there should be, and each page begins with an IDR picture
 * and an SPS of its size.
 */
export function pageSamples(samples: Sample[], atlas: Atlas, frames: number, where: string): Sample[][] {
  const count = pages(atlas);
  if (samples.length !== count * frames) {
    throw new FormatError("bad_picture", where, `expected ${count} × ${frames} pictures, got ${samples.length}`);
  }
  const parts = Array.from({ length: count }, (_, page) => samples.slice(page * frames, (page + 1) * frames));
  for (const [page, part] of parts.entries()) {
    const first = part[0]!.data;
    if (!isIdr(first, where)) throw new FormatError("bad_picture", where, `page ${page} does not begin with an IDR`);
    const { width, height } = readParameters(first, where);
    if (width !== atlas.width || height !== atlas.height) {
      const expected = `${atlas.width}x${atlas.height} for ${atlasLines(atlas)} lines`;
      throw new FormatError("bad_picture", where, `expected ${expected}, got ${width}x${height}`);
    }
  }
  return parts;
}

/** Chroma, depths and scaling matrices. */
function skipHigh(bits: Bits): void {
  const chroma = bits.ue();
  const depths = [bits.ue(), bits.ue()];
  if (chroma !== 1 || depths.some((depth) => depth)) throw bits.refuse(`chroma format ${chroma}, depths 8 + ${depths}`);
  bits.read(1);
  if (!bits.read(1)) return;
  for (let list = 0; list < 8; list++) {
    if (bits.read(1)) skipScaling(bits, list < 6 ? 16 : 64);
  }
}

/** A scaling list: 7.3.2.1.1.1. */
function skipScaling(bits: Bits, size: number): void {
  let last = 8;
  let next = 8;
  for (let i = 0; i < size; i++) {
    if (next) next = (last + bits.se() + 256) % 256;
    if (next) last = next;
  }
}

function skipOrder(bits: Bits): void {
  const type = bits.ue();
  if (type === 0) bits.ue();
  if (type !== 1) return;
  bits.read(1);
  bits.ue();
  bits.ue();
  for (let left = bits.ue(); left > 0; left--) bits.ue();
}

/** The bits of a NAL unit without its emulation prevention bytes. */
class Bits {
  #data: Uint8Array;
  #at = 0;

  constructor(
    unit: Uint8Array,
    readonly where: string,
  ) {
    this.#data = unit.filter((byte, i) => !(byte === 3 && i > 1 && !unit[i - 1] && !unit[i - 2]));
  }

  read(count: number): number {
    let value = 0;
    for (let i = 0; i < count; i++, this.#at++) {
      const byte = this.#data[this.#at >> 3];
      if (byte === undefined) throw this.refuse("an end too early");
      value = value * 2 + ((byte >> (7 - (this.#at & 7))) & 1);
    }
    return value;
  }

  /** An Exp-Golomb code: 9.1. */
  ue(): number {
    let zeros = 0;
    while (!this.read(1)) zeros++;
    return 2 ** zeros - 1 + this.read(zeros);
  }

  se(): number {
    const code = this.ue();
    return code & 1 ? (code + 1) / 2 : -code / 2;
  }

  refuse(what: string): FormatError {
    return new FormatError("bad_picture", this.where, `expected a parameter set of 8-bit 4:2:0 H.264, got ${what}`);
  }
}

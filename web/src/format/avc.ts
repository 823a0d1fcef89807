// H.264 as far as a reader needs it without decoding: ISO/IEC 14496-10, NAL units (7.3.1) and SPS (7.3.2.1).
import { pages } from "./atlas.ts";
import { FormatError } from "./errors.ts";
import type { Sample } from "./mp4.ts";
import type { Atlas } from "./types.ts";

const IDR = 5;
const SPS = 7;
/** Baseline, main, extended and high: of 8 bits and with chroma 4:2:0, or grey (A.2). */
const PROFILES = [66, 77, 88, 100];

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

const unitOf = (type: number, sample: Uint8Array, where: string) =>
  nalUnits(sample, where).find((unit) => (unit[0]! & 31) === type);

/** RFC 6381, for decoders that are configured without a description and take Annex B; from the SPS in band of a sample.
 *
 * Throws FormatError(bad_picture) where there is none, or of a profile with other depths or chroma.
 */
export function codecOf(sample: Uint8Array, where: string): string {
  const unit = unitOf(SPS, sample, where);
  if (!unit) throw new FormatError("bad_picture", where, "expected a sequence parameter set before the IDR picture");
  const [profile, ...rest] = unit.subarray(1, 4);
  if (!PROFILES.includes(profile!))
    throw new FormatError("bad_picture", where, `expected 8-bit 4:2:0 H.264, got profile ${profile}`);
  return `avc1.${[profile!, ...rest].map((byte) => byte.toString(16).padStart(2, "0").toUpperCase()).join("")}`;
}

/** The samples of each page of `frames` pictures of an atlas, in decoding order.
 *
 * Throws FormatError(bad_picture) unless there are as many as there should be, and each page begins with an IDR picture
 * and its SPS. Whether they have the size of the atlas is seen when they are decoded.
 */
export function pageSamples(samples: Sample[], atlas: Atlas, frames: number, where: string): Sample[][] {
  const count = pages(atlas);
  if (samples.length !== count * frames) {
    throw new FormatError("bad_picture", where, `expected ${count} × ${frames} pictures, got ${samples.length}`);
  }
  const parts = Array.from({ length: count }, (_, page) => samples.slice(page * frames, (page + 1) * frames));
  for (const [page, [first]] of parts.entries()) {
    if (!unitOf(IDR, first!.data, where))
      throw new FormatError("bad_picture", where, `page ${page} does not begin with an IDR`);
    codecOf(first!.data, where);
  }
  return parts;
}

// What this browser makes of H.264: whether luma can be had as it was coded.
import { BLOCK, BRIGHTEST, DARKEST } from "../generated/constants.ts";
import type { Inverses, Samples } from "./decoder.ts";
import { LumaDecoder } from "./decoder.ts";
import { UnsupportedError } from "./errors.ts";
import { PROBE_BLOCKS, PROBE_CLIP } from "./probe-clip.ts";

const SIDE = PROBE_BLOCKS * BLOCK;
const VALUES = 256;

/** What the probe found: luma as it is coded, or changed by a table that can be undone. */
export interface Probe {
  luma: "exact" | "invertible";
  inverses: Inverses;
  /** What to ask decoders for, so that they do the same. */
  acceleration: HardwareAcceleration;
}

/** Throws UnsupportedError where a page of this browser cannot decode H.264 with WebCodecs at all. */
export function checkBrowser(): void {
  if (!globalThis.isSecureContext) {
    throw new UnsupportedError("browsers decode video for pages of https:// or localhost only, not for this address");
  }
  if (typeof VideoDecoder === "undefined") {
    throw new UnsupportedError(
      "this browser has no WebCodecs (VideoDecoder); Chrome, Edge, Safari from 16.4 on and, but for Android, Firefox " +
        "from 130 on have it",
    );
  }
}

/** Decodes a known picture. Throws UnsupportedError where this browser decodes no H.264, or changes it for good. */
export async function probeBrowser(): Promise<Probe> {
  checkBrowser();
  try {
    return await probe("no-preference");
  } catch {
    return await probe("prefer-software"); // where the decoder of the hardware is the one that errs
  }
}

async function probe(acceleration: HardwareAcceleration): Promise<Probe> {
  let found: Probe | null = null;
  const decoder = new LumaDecoder(acceleration);
  try {
    const data = Uint8Array.from(atob(PROBE_CLIP), (letter) => letter.charCodeAt(0));
    const clip = { samples: [{ data, time: 0, duration: 1 }], width: SIDE, height: SIDE, where: "the probe" };
    await decoder.decode(clip, (samples) => {
      found = { ...judge(samples), acceleration };
    });
    if (found) return found;
  } catch (error) {
    if (error instanceof UnsupportedError) throw error;
    throw new UnsupportedError(`this browser does not decode H.264: ${(error as Error).message}`);
  } finally {
    decoder.close();
  }
  throw new UnsupportedError("this browser does not decode H.264: it gave no picture");
}

export function judge(samples: Samples): Omit<Probe, "acceleration"> {
  const seen = Uint8Array.from({ length: VALUES }, (_, value) => blockValue(samples, value));
  const inverse = invert(seen);
  const same = seen.every((got, value) => got === value || value < DARKEST || value > BRIGHTEST);
  return { luma: same ? "exact" : "invertible", inverses: { [samples.layout]: same ? null : inverse } };
}

/** The value that a block became, the same in all of its samples. */
function blockValue({ data, offset, stride, step }: Samples, value: number): number {
  const at = (i: number) => {
    const line = Math.floor(value / PROBE_BLOCKS) * BLOCK + Math.floor(i / BLOCK);
    return data[offset + line * stride + ((value % PROBE_BLOCKS) * BLOCK + (i % BLOCK)) * step];
  };
  const first = at(0);
  for (let i = 1; i < BLOCK * BLOCK; i++) if (at(i) !== first) throw mangled(`flat areas of luma ${value} come uneven`);
  return first;
}

/** The table from what came to what was coded, for all luma that packages hold; what never comes stands for itself. */
function invert(seen: Uint8Array): Uint8Array {
  const inverse = Uint8Array.from({ length: VALUES }, (_, i) => i);
  const from = new Map<number, number>();
  for (let value = DARKEST; value <= BRIGHTEST; value++) {
    const other = from.get(seen[value]);
    if (other !== undefined) throw mangled(`${other} and ${value} both come as ${seen[value]}`);
    from.set(seen[value], value);
    inverse[seen[value]] = value;
  }
  return inverse;
}

function mangled(how: string): UnsupportedError {
  return new UnsupportedError(`this browser changes the luma of H.264 pictures for good: ${how}`);
}

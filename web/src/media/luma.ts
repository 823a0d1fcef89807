// Luma of decoded pictures, whatever the browser makes of them.
import { UnsupportedError } from "./errors.ts";

/** Layouts of samples in which browsers give pictures: luma as a plane of its own, or pixels of grey. */
export type Layout = "planar" | "rgb";

/** What undoes a browser's changes, sample by sample; null: it changes nothing. Layouts that are missing were not seen. */
export type Inverses = Partial<Record<Layout, Uint8Array | null>>;

/** Pictures in a layout that the probe did not meet: a decoder in software may give them in the one that it did. */
export class LayoutError extends UnsupportedError {}

const PLANAR = /^(I420A?|NV12)$/;
const PIXELS = /^(RGB|BGR)[AX]$/;
const PIXEL_BYTES = 4;
const GREEN = 1; // of RGBX and BGRX alike

/** How the samples of a picture lie, and what to ask `copyTo` for; pictures that only the GPU can read become pixels. */
function layoutOf(frame: VideoFrame): { layout: Layout; options: VideoFrameCopyToOptions } {
  const { format } = frame;
  if (format === null) return { layout: "rgb", options: { format: "RGBX" } };
  if (PLANAR.test(format)) return { layout: "planar", options: {} };
  if (PIXELS.test(format)) return { layout: "rgb", options: {} };
  throw new UnsupportedError(`this browser gives pictures as ${format}, from which luma cannot be read exactly`);
}

export interface Samples {
  layout: Layout;
  data: Uint8Array;
  /** Byte of the first sample of luma, bytes from a line to the next, and from a sample to the next. */
  offset: number;
  stride: number;
  step: number;
}

/** Copies a picture out of the decoder's hands into a free buffer, and closes it whatever happens. */
export async function copySamples(frame: VideoFrame, free: Uint8Array[]): Promise<Samples> {
  try {
    const { layout, options } = layoutOf(frame);
    const bytes = frame.allocationSize(options);
    const last = free.pop();
    const data = last?.length === bytes ? last : new Uint8Array(bytes);
    const [first] = await frame.copyTo(data, options);
    const step = layout === "planar" ? 1 : PIXEL_BYTES;
    return { layout, data, offset: first.offset + (step > 1 ? GREEN : 0), stride: first.stride, step };
  } finally {
    frame.close();
  }
}

/** Puts luma of `width` × `height` samples line by line into `luma`, as the decoder made it. */
export function readLuma(samples: Samples, width: number, height: number, inverses: Inverses, luma: Uint8Array): void {
  const { data, offset, stride, step } = samples;
  const inverse = inverseFor(samples.layout, inverses);
  for (let line = 0; line < height; line++) {
    const from = offset + line * stride;
    const to = line * width;
    if (step === 1 && !inverse) luma.set(data.subarray(from, from + width), to);
    else
      for (let x = 0; x < width; x++) luma[to + x] = inverse ? inverse[data[from + step * x]] : data[from + step * x];
  }
}

function inverseFor(layout: Layout, inverses: Inverses): Uint8Array | null {
  const known = inverses[layout];
  if (known !== undefined) return known;
  throw new LayoutError(`this browser gives some H.264 pictures as ${layout} and others not: luma cannot be trusted`);
}

// Browsers that give pictures otherwise than this one does: what the probe says of them, and what luma comes to.

import { type Inverses, LumaDecoder, readLuma } from "../../src/media/decoder.ts";
import { judge, probeBrowser } from "../../src/media/probe.ts";
import { PROBE_CLIP } from "../../src/media/probe-clip.ts";

const PADDING = 32; // bytes at the end of every line
const START = 64; // and before the first

/** Luma that a browser gives in place of what was coded. */
type Change = (luma: number) => number;

const CHANGES: Record<string, Change> = {
  same: (luma) => luma,
  stretched: (luma) => Math.min(255, Math.max(0, Math.round(((luma - 16) * 255) / 219))),
  negative: (luma) => 255 - luma,
  squeezed: (luma) => Math.round(16 + (luma * 219) / 255),
  clipped: (luma) => Math.min(200, luma),
};

/** Puts luma, line by line, where a format has it. */
function lay(format: string, luma: Uint8Array, width: number, change: Change): { data: Uint8Array; stride: number } {
  const step = /^(NV12|I420)$/.test(format) ? 1 : 4;
  const stride = width * step + PADDING;
  const data = new Uint8Array(START + stride * (luma.length / width) * 2).fill(77);
  luma.forEach((value, i) => {
    const at = START + Math.floor(i / width) * stride + (i % width) * step;
    data.fill(change(value), at, at + Math.min(step, 3));
  });
  return { data, stride };
}

const real = {
  copyTo: VideoFrame.prototype.copyTo,
  allocationSize: VideoFrame.prototype.allocationSize,
  format: Object.getOwnPropertyDescriptor(VideoFrame.prototype, "format") as PropertyDescriptor,
};

/** Makes all pictures of this page come in a format; null: that only `copyTo` can read. */
function pretend(format: string | null, change: Change): void {
  const laid = format ?? "RGBX";
  VideoFrame.prototype.allocationSize = function () {
    const { width, height } = this.visibleRect as DOMRectReadOnly;
    return lay(laid, new Uint8Array(width * height), width, change).data.length;
  };
  VideoFrame.prototype.copyTo = async function (target, options) {
    if (format === null && options?.format !== "RGBX") throw new DOMException("unreadable", "NotSupportedError");
    const { width, height } = this.visibleRect as DOMRectReadOnly;
    const all = new Uint8Array(real.allocationSize.call(this));
    const [{ offset, stride }] = await real.copyTo.call(this, all);
    const luma = new Uint8Array(width * height);
    for (let y = 0; y < height; y++)
      luma.set(all.subarray(offset + y * stride, offset + y * stride + width), y * width);
    const made = lay(laid, luma, width, change);
    (target as Uint8Array).set(made.data);
    return [{ offset: START, stride: made.stride }];
  };
  Object.defineProperty(VideoFrame.prototype, "format", { get: () => format, configurable: true });
}

function restore(): void {
  VideoFrame.prototype.copyTo = real.copyTo;
  VideoFrame.prototype.allocationSize = real.allocationSize;
  Object.defineProperty(VideoFrame.prototype, "format", real.format);
}

/** What the probe says of a pretended browser, and the luma of 16 to 235 that it then reads wrongly. */
async function probe(step: Record<string, unknown>): Promise<unknown> {
  const { format, change } = step as { format?: string | null; change?: string };
  if (format !== undefined) pretend(format, CHANGES[change ?? "same"]);
  try {
    const { luma, inverses, acceleration } = await probeBrowser();
    const decoder = new LumaDecoder(acceleration);
    const wrong = await wronglyRead(decoder, inverses);
    decoder.close();
    return { luma, layouts: Object.keys(inverses), wrong };
  } finally {
    restore();
  }
}

/** Luma of the probe's picture, of that which packages have, that does not come as it was coded. */
async function wronglyRead(decoder: LumaDecoder, inverses: Inverses): Promise<number[]> {
  const wrong: number[] = [];
  const data = Uint8Array.from(atob(PROBE_CLIP), (letter) => letter.charCodeAt(0));
  const clip = { samples: [{ data, time: 0, duration: 1 }], width: 256, height: 256, where: "clip" };
  await decoder.decode(clip, (samples) => {
    const luma = new Uint8Array(256 * 256);
    readLuma(samples, 256, 256, inverses, luma);
    luma.forEach((value, i) => {
      const coded = 16 * Math.floor(i / 256 / 16) + Math.floor((i % 256) / 16);
      if (value !== coded && coded >= 16 && coded <= 235) wrong.push(coded);
    });
  });
  return wrong;
}

/** A browser whose hardware, unlike its decoder in software, gives pixels of pictures larger than the probe's. */
async function hardware({ helps }: Record<string, unknown>): Promise<unknown> {
  const { inverses } = await probeBrowser();
  const asked: unknown[] = [];
  const { configure } = VideoDecoder.prototype;
  VideoDecoder.prototype.configure = function (config) {
    asked.push(config.hardwareAcceleration);
    if (helps && config.hardwareAcceleration === "prefer-software") restore();
    configure.call(this, config);
  };
  pretend("BGRX", CHANGES.stretched);
  const decoder = new LumaDecoder();
  try {
    return { wrong: await wronglyRead(decoder, inverses), asked };
  } finally {
    VideoDecoder.prototype.configure = configure;
    decoder.close();
    restore();
  }
}

/** A picture whose flat blocks are not flat. */
async function uneven(): Promise<unknown> {
  const data = Uint8Array.from(
    { length: 256 * 256 },
    (_, i) => 16 * Math.floor(i / 256 / 16) + Math.floor((i % 256) / 16),
  );
  data[100 * 256 + 100]++;
  return judge({ layout: "planar", data, offset: 0, stride: 256, step: 1 });
}

/** What is said where a part of the browser is missing. */
async function lacking(step: Record<string, unknown>): Promise<unknown> {
  const { what } = step as { what: string };
  const before = Object.getOwnPropertyDescriptor(globalThis, what) as PropertyDescriptor;
  Object.defineProperty(globalThis, what, { value: undefined, configurable: true });
  try {
    return await probeBrowser();
  } finally {
    Object.defineProperty(globalThis, what, before);
  }
}

/** A browser without H.264. */
async function unable(): Promise<unknown> {
  const before = VideoDecoder.isConfigSupported;
  VideoDecoder.isConfigSupported = async (config) => ({ supported: false, config });
  try {
    return await probeBrowser();
  } finally {
    VideoDecoder.isConfigSupported = before;
  }
}

export const probes = { probe, hardware, uneven, lacking, unable };

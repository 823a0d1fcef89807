// H.264 through WebCodecs: coded pictures in, samples of decoded pictures out, in the order in which they are shown.
import { annexB, codecOf } from "../format/avc.ts";
import { FormatError } from "../format/errors.ts";
import type { Sample } from "../format/mp4.ts";
import { Bell } from "./bell.ts";
import { aborted, UnsupportedError } from "./errors.ts";

/** Pictures on their way out of a decoder, and chunks on their way in: 20 unclosed pictures block some decoders. */
const MOST_UNDER_WAY = 4;

export interface Clip {
  /** In decoding order; pages one after the other, each of which begins with an IDR picture. */
  samples: Sample[];
  width: number;
  height: number;
  where: string;
}

export interface DecodeOptions {
  signal?: AbortSignal | undefined;
  room?: (() => Promise<void>) | undefined;
  first?: number | undefined;
}

/** What becomes of the n-th picture; its samples are good until the promise resolves. */
export type TakeSamples = (samples: Samples, n: number) => void | Promise<void>;

/** A video decoder that lives from file to file. One file is decoded at a time, others wait for their turn.
 *
 * A decoder that the browser took away, as it may when a page pauses, is made anew, and goes on where it was; one in
 * software takes the place of one that gives pictures in a layout which is not known.
 */
export class LumaDecoder {
  #acceleration: HardwareAcceleration;
  readonly #free: Uint8Array[] = [];
  #decoder: VideoDecoder | null = null;
  #configured = "";
  #pass: Pass | null = null;
  #turn: Promise<unknown> = Promise.resolve();

  constructor(acceleration: HardwareAcceleration = "no-preference") {
    this.#acceleration = acceleration;
  }

  /** Decodes a clip and gives each picture to `take`; resolves to how many there were.
   *
   * Throws FormatError(bad_picture) for what does not decode twice, AbortError, and what `take` throws.
   */
  decode(clip: Clip, take: TakeSamples, options: DecodeOptions = {}): Promise<number> {
    const mine = this.#turn.then(() => this.#persist(clip, take, options));
    this.#turn = mine.catch(() => {});
    return mine;
  }

  close(): void {
    this.#pass?.fail(aborted("the decoder was closed"));
    this.#drop();
  }

  async #persist(clip: Clip, take: TakeSamples, options: DecodeOptions): Promise<number> {
    for (let done = 0, failures = 0; ; ) {
      const pass = new Pass(clip, take, done, this.#free);
      const error = await this.#run(pass, options);
      if (!error) return pass.shown;
      failures = pass.done > done ? 1 : failures + 1;
      done = pass.done;
      if (error instanceof LayoutError && this.#acceleration !== "prefer-software") {
        this.#acceleration = "prefer-software";
        failures = 0;
      } else if (error instanceof FormatError || error instanceof UnsupportedError || error.name === "AbortError")
        throw error;
      if (failures > 1) throw new FormatError("bad_picture", clip.where, `H.264 does not decode: ${error.message}`);
    }
  }

  /** Decodes once; resolves to what went wrong, when no picture is open any more. */
  async #run(pass: Pass, { signal, room }: DecodeOptions): Promise<Error | null> {
    const stop = () => pass.fail(aborted());
    signal?.addEventListener("abort", stop);
    if (signal?.aborted) stop();
    this.#pass = pass;
    try {
      if (!pass.error) await this.#feed(pass, room);
    } catch (error) {
      pass.fail(error as Error);
    }
    signal?.removeEventListener("abort", stop);
    this.#pass = null;
    if (pass.error) this.#drop(); // it may still hold pictures
    await pass.copies;
    return pass.error;
  }

  async #feed(pass: Pass, room: DecodeOptions["room"]): Promise<void> {
    const { samples, where } = pass.clip;
    const decoder = await this.#ready(pass);
    for (const [i, sample] of samples.entries()) {
      await pass.until(() => decoder.decodeQueueSize < MOST_UNDER_WAY && pass.open < MOST_UNDER_WAY);
      await room?.();
      if (pass.error) return;
      const data = annexB(sample.data, where);
      const { time: timestamp, duration } = sample;
      decoder.decode(new EncodedVideoChunk({ type: i ? "delta" : "key", timestamp, duration, data }));
    }
    await Promise.race([decoder.flush(), pass.until(() => false)]);
    await pass.copies;
  }

  async #ready({ clip }: Pass): Promise<VideoDecoder> {
    const { width: codedWidth, height: codedHeight, where } = clip;
    const codec = codecOf(clip.samples[0].data, where);
    const config = { codec, codedWidth, codedHeight, hardwareAcceleration: this.#acceleration };
    const name = JSON.stringify(config);
    if (this.#decoder?.state !== "configured") this.#make();
    const decoder = this.#decoder as VideoDecoder;
    if (name === this.#configured) return decoder;
    const { supported } = await VideoDecoder.isConfigSupported(config);
    if (!supported)
      throw new UnsupportedError(`this browser does not decode H.264 (${codec}) of ${codedWidth}x${codedHeight}`);
    decoder.configure(config);
    this.#configured = name;
    return decoder;
  }

  #make(): void {
    this.#drop();
    const decoder: VideoDecoder = new VideoDecoder({
      output: (frame) => (this.#decoder === decoder && this.#pass ? this.#pass.show(frame) : frame.close()),
      error: (error) => this.#decoder === decoder && this.#pass?.fail(error),
    });
    decoder.addEventListener("dequeue", () => this.#pass?.bell.ring());
    this.#decoder = decoder;
  }

  #drop(): void {
    if (this.#decoder && this.#decoder.state !== "closed") this.#decoder.close();
    this.#decoder = null;
    this.#configured = "";
  }
}

class Pass {
  readonly bell = new Bell();
  shown = 0;
  open = 0;
  error: Error | null = null;
  /** Resolves when every picture that came so far is closed, and taken unless something went wrong. */
  copies: Promise<void> = Promise.resolve();
  #last = Number.NEGATIVE_INFINITY;

  /** The first `done` pictures were taken before. */
  constructor(
    readonly clip: Clip,
    readonly take: TakeSamples,
    public done: number,
    readonly free: Uint8Array[],
  ) {}

  fail(error: Error): void {
    this.error ??= error;
    this.bell.ring();
  }

  until(condition: () => boolean): Promise<void> {
    return this.bell.until(() => !!this.error || condition());
  }

  show(frame: VideoFrame): void {
    const n = this.shown++;
    const bad = this.#complaint(frame, n);
    if (bad) this.fail(new FormatError("bad_picture", this.clip.where, bad));
    if (this.error || n < this.done) {
      frame.close();
      return;
    }
    this.open++;
    const copy = copySamples(frame, this.free);
    copy.catch(() => {}); // it is waited for below, when those before it are done
    this.copies = this.copies.then(() => this.#hand(copy, n));
  }

  #complaint({ visibleRect, timestamp }: VideoFrame, n: number): string | null {
    const { width, height, samples } = this.clip;
    if (n >= samples.length) return `expected ${samples.length} pictures, got more`;
    if (visibleRect?.width !== width || visibleRect.height !== height) {
      return `expected ${width}x${height}, got ${visibleRect?.width}x${visibleRect?.height}`;
    }
    if (timestamp <= this.#last) return "pictures do not come in the order of their times";
    this.#last = timestamp;
    return null;
  }

  async #hand(copy: Promise<Samples>, n: number): Promise<void> {
    try {
      const samples = await copy;
      if (!this.error) {
        await this.take(samples, n);
        this.done = n + 1;
      }
      this.free.push(samples.data);
    } catch (error) {
      this.fail(error as Error);
    }
    this.open--;
    this.bell.ring();
  }
}

/** Layouts of samples in which browsers give pictures: luma as a plane of its own, or pixels of grey. */
export type Layout = "planar" | "rgb";

/** What undoes a browser's changes, sample by sample; null: it changes nothing. Missing layouts were not seen. */
export type Inverses = Partial<Record<Layout, Uint8Array | null>>;

/** Pictures in a layout that the probe did not meet: a decoder in software may give them in the one that it did. */
export class LayoutError extends UnsupportedError {}

const PLANAR = /^(I420A?|NV12)$/;
const PIXELS = /^(RGB|BGR)[AX]$/;
const PIXEL_BYTES = 4;
const GREEN = 1; // of RGBX and BGRX alike

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
    const { format } = frame;
    const layout = format && PLANAR.test(format) ? "planar" : "rgb";
    if (format && layout === "rgb" && !PIXELS.test(format))
      throw new UnsupportedError(`this browser gives pictures as ${format}, from which luma cannot be read exactly`);
    const options: VideoFrameCopyToOptions = format ? {} : { format: "RGBX" }; // null: only the GPU can read it
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
  const inverse = inverses[samples.layout];
  if (inverse === undefined)
    throw new LayoutError(
      `this browser gives some H.264 pictures as ${samples.layout} and others not: luma cannot be trusted`,
    );
  for (let line = 0; line < height; line++) {
    const from = offset + line * stride;
    const to = line * width;
    if (step === 1 && !inverse) luma.set(data.subarray(from, from + width), to);
    else
      for (let x = 0; x < width; x++) luma[to + x] = inverse ? inverse[data[from + step * x]] : data[from + step * x];
  }
}

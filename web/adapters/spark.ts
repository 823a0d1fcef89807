// Frames of a package in three.js, drawn by spark 2.2 (README.md).
import { ExtSplats, type SparkRendererOptions, SplatMesh, utils } from "@sparkjsdev/spark";
import { Group, type Texture } from "three";
import type { Gaussians } from "../src/format/types.ts";
import { SH_C0 } from "../src/generated/constants.ts";

/** What makes spark draw as the renderer that packages are measured with: the picture is blurred by 0.3 px² without
 * dimming, a Gaussian ends where its alpha is 1/255, one is drawn whose middle is beside the picture, and the depth
 * order goes by the view axis. ExtSplats hold what PackedSplats round too coarsely. */
export const SPARK_SETTINGS: Omit<SparkRendererOptions, "renderer"> = {
  accumExtSplats: true,
  preBlurAmount: 0.3,
  blurAmount: 0,
  minAlpha: 1 / 255,
  maxStdDev: Math.sqrt(2 * Math.log(255)),
  maxPixelRadius: 8192,
  sortRadial: false,
  clipXY: 2,
  enableLod: false,
};

const SH_WORDS = ["sh1", "sh2", "sh3a", "sh3b"]; // four coefficients each, in order
const SCALES = Array.from({ length: 32 }, (_, exponent) => 255 * 2 ** (15 - exponent));
const most = new Float32Array(1);
const mostBits = new Uint32Array(most.buffer);
const level = (value: number) => Math.min(255, (value + 0.5) | 0);

// An SH coefficient past DC as spark has it: 8 bits each of r, g, b, their signs, and one exponent: that of the power of two
// above the largest. spark's own encodeExtRgb (2.2.0) takes the one below, and cuts off what is larger.
function packRgb(colours: Float32Array, bits: Uint32Array, at: number): number {
  const [r, g, b] = [Math.abs(colours[at]), Math.abs(colours[at + 1]), Math.abs(colours[at + 2])];
  most[0] = Math.max(r, g, b);
  const exponent = Math.max(0, Math.min(31, (mostBits[0] >>> 23) - 111));
  const signs = (bits[at] >>> 31) | ((bits[at + 1] >>> 31) << 1) | ((bits[at + 2] >>> 31) << 2);
  const scale = SCALES[exponent];
  return (exponent << 27) | (signs << 24) | (level(b * scale) << 16) | (level(g * scale) << 8) | level(r * scale);
}

export class AirgsSplats extends Group {
  #mesh: SplatMesh | null = null;
  #splats = new ExtSplats();
  #rest = 0; // SH coefficients past DC

  /** Draws `gaussians` from the next picture on. Nothing is allocated while rows and SH coefficients stay as many. */
  show(gaussians: Gaussians): void {
    const rows = gaussians.alpha.length;
    const rest = rows ? gaussians.colours.length / rows / 3 - 1 : this.#rest;
    if (!this.#mesh || 4 * rows > this.#splats.extArrays[0].length || rest !== this.#rest) this.#allocate(rows, rest);
    this.#fill(gaussians, rows);
    this.#splats.numSplats = rows;
    this.#mesh!.numSplats = rows;
    this.#mesh!.updateVersion();
  }

  override dispose(): void {
    this.#mesh?.removeFromParent().dispose();
    this.#mesh = null;
  }

  #allocate(rows: number, rest: number): void {
    this.dispose();
    const words = () => new Uint32Array(4 * utils.getTextureSize(Math.max(rows, 1)).maxSplats);
    const extra = Object.fromEntries(SH_WORDS.slice(0, Math.ceil(rest / 4)).map((name) => [name, words()]));
    this.#splats = new ExtSplats({ extArrays: [words(), words()], numSplats: rows, extra });
    this.#mesh = new SplatMesh({ extSplats: this.#splats, raycastable: false, editable: false });
    this.#rest = rest;
    this.add(this.#mesh);
  }

  #fill({ means, quaternions, logScales, alpha, colours }: Gaussians, rows: number): void {
    const { extArrays, extra, textures } = this.#splats;
    const [a, b] = extArrays;
    const places = new Float32Array(a.buffer);
    const words = SH_WORDS.map((name) => extra[name] as Uint32Array);
    const bits = new Uint32Array(colours.buffer, colours.byteOffset, colours.length);
    const { toHalf: half, encodeQuatOctXy1010R12: quaternion } = utils;
    const dc = (at: number) => half(SH_C0 * colours[at] + 0.5);
    for (let i = 0, m = 0, q = 0, c = 0; i < rows; i++, m += 3, q += 4) {
      for (let axis = 0; axis < 3; axis++) places[q + axis] = means[m + axis];
      a[q + 3] = half(alpha[i]);
      b[q] = dc(c) | (dc(c + 1) << 16);
      b[q + 1] = dc(c + 2) | (half(logScales[m]) << 16);
      b[q + 2] = half(logScales[m + 1]) | (half(logScales[m + 2]) << 16);
      b[q + 3] = quaternion(quaternions[q + 1], quaternions[q + 2], quaternions[q + 3], quaternions[q]);
      c += 3;
      for (let k = 0; k < this.#rest; k++, c += 3) words[k >> 2][q + (k & 3)] = packRgb(colours, bits, c);
    }
    const held = Object.values(extra as Record<string, { value?: Texture } | null>).map((one) => one?.value);
    for (const texture of [...textures, ...held]) if (texture) texture.needsUpdate = true;
  }
}

// Frames of an AirGS package in three.js, drawn by spark. Copy this file: it needs those, and what a reader gives.
//
//     const spark = new SparkRenderer({ renderer, ...SPARK_SETTINGS });
//     const splats = new AirgsSplats();
//     scene.add(spark, splats);
//     splats.show(await reader.gaussians(frame));   // as often as you like
import { ExtSplats, type SparkRendererOptions, SplatMesh, utils } from "@sparkjsdev/spark";
import { type DataArrayTexture, Group } from "three";
import type { Gaussians } from "../../src/airgs-frames.ts";

/**
 * What makes spark draw as the renderer that packages are measured with: the picture is blurred by 0.3 px² without
 * dimming, a Gaussian ends where its alpha is 1/255, one is drawn whose middle is beside the picture, and the depth
 * order goes by the view axis. ExtSplats hold what PackedSplats round too coarsely.
 */
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

const SH_DC = 0.28209479177387814; // 1 / (2 √π)
const SH_WORDS = ["sh1", "sh2", "sh3a", "sh3b"] as const; // four coefficients each, in order
const SCALES = Array.from({ length: 32 }, (_, exponent) => 255 * 2 ** (15 - exponent));
const most = new Float32Array(1);
const mostBits = new Uint32Array(most.buffer);
const level = (value: number) => Math.min(255, (value + 0.5) | 0);

/**
 * An SH coefficient past DC as spark has it: 8 bits each of r, g, b, their signs, and one exponent.
 *
 * The exponent is that of the power of two above the largest. spark's own encodeExtRgb (2.2.0) takes the one below, and
 * cuts off what is larger.
 */
function packRgb(colours: Float32Array, bits: Uint32Array, at: number): number {
  const r = Math.abs(colours[at]!);
  const g = Math.abs(colours[at + 1]!);
  const b = Math.abs(colours[at + 2]!);
  most[0] = Math.max(r, g, b);
  const exponent = Math.max(0, Math.min(31, (mostBits[0]! >>> 23) - 111));
  const signs = (bits[at]! >>> 31) | ((bits[at + 1]! >>> 31) << 1) | ((bits[at + 2]! >>> 31) << 2);
  const scale = SCALES[exponent]!;
  return (exponent << 27) | (signs << 24) | (level(b * scale) << 16) | (level(g * scale) << 8) | level(r * scale);
}

export class AirgsSplats extends Group {
  #mesh: SplatMesh | null = null;
  #splats = new ExtSplats();
  #rest = 0; // SH coefficients past DC
  #capacity = 0; // rows

  /** Draws `gaussians` from the next picture on. Nothing is allocated while rows and SH coefficients stay as many. */
  show(gaussians: Gaussians): void {
    const rows = gaussians.alpha.length;
    const rest = rows ? gaussians.colours.length / rows / 3 - 1 : 0;
    if (!this.#mesh || rows > this.#capacity || rest !== this.#rest) this.#allocate(rows, rest);
    this.#fill(gaussians, rows);
    this.#splats.numSplats = rows;
    this.#mesh!.numSplats = rows;
    this.#mesh!.updateVersion();
  }

  /** Frees what is on the GPU. */
  override dispose(): void {
    this.#mesh?.removeFromParent().dispose();
    this.#mesh = null;
    super.dispose();
  }

  #allocate(rows: number, rest: number): void {
    this.#mesh?.removeFromParent().dispose();
    const { maxSplats } = utils.getTextureSize(Math.max(rows, 1));
    const words = () => new Uint32Array(4 * maxSplats);
    const names = SH_WORDS.slice(0, Math.ceil(rest / 4));
    const extra = rest ? Object.fromEntries(names.map((name) => [name, words()])) : {};
    this.#splats = new ExtSplats({ extArrays: [words(), words()], numSplats: rows, extra });
    this.#mesh = new SplatMesh({ extSplats: this.#splats, raycastable: false, editable: false });
    this.#capacity = maxSplats;
    this.#rest = rest;
    this.add(this.#mesh);
  }

  #fill(g: Gaussians, rows: number): void {
    const [a, b] = this.#splats.extArrays;
    const places = new Float32Array(a.buffer);
    const { toHalf: half, encodeQuatOctXy1010R12: quaternion } = utils;
    const stride = 3 * (this.#rest + 1);
    for (let i = 0, m = 0, q = 0, c = 0; i < rows; i++, m += 3, q += 4, c += stride) {
      places[q] = g.means[m]!;
      places[q + 1] = g.means[m + 1]!;
      places[q + 2] = g.means[m + 2]!;
      a[q + 3] = half(g.alpha[i]!);
      b[q] = half(SH_DC * g.colours[c]! + 0.5) | (half(SH_DC * g.colours[c + 1]! + 0.5) << 16);
      b[q + 1] = half(SH_DC * g.colours[c + 2]! + 0.5) | (half(g.logScales[m]!) << 16);
      b[q + 2] = half(g.logScales[m + 1]!) | (half(g.logScales[m + 2]!) << 16);
      b[q + 3] = quaternion(g.quaternions[q + 1]!, g.quaternions[q + 2]!, g.quaternions[q + 3]!, g.quaternions[q]!);
    }
    this.#fillRest(g.colours, rows);
    for (const texture of this.#splats.textures) texture.needsUpdate = true;
  }

  #fillRest(colours: Float32Array, rows: number): void {
    const extra = this.#splats.extra;
    const bits = new Uint32Array(colours.buffer, colours.byteOffset, colours.length);
    const words = SH_WORDS.map((name) => extra[name] as Uint32Array);
    for (let i = 0; i < rows; i++)
      for (let k = 0, c = 3 * (this.#rest + 1) * i + 3; k < this.#rest; k++, c += 3)
        words[k >> 2]![4 * i + (k & 3)] = packRgb(colours, bits, c);
    for (const name of ["sh1Texture", "sh2Texture", "sh3TextureA", "sh3TextureB"]) {
      const held = extra[name] as { value: DataArrayTexture } | undefined; // there from the first picture on
      if (held) held.value.needsUpdate = true;
    }
  }
}

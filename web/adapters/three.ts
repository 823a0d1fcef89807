// Frames of a package as three.js' own GaussianSplat (README.md). three 0.187 has no way to change Gaussians that are
// there, so this writes into what it keeps to itself. Its colours are blended as they are shown, not as light.
import { GaussianSplat } from "three/addons/objects/GaussianSplat.js";
import { createGaussianSplatGeometry, SH_BAND_WORDS, writeCovariance } from "three/addons/utils/GaussianSplatUtils.js";
import { Box3, Group, Sphere, type StorageBufferAttribute, type Texture } from "three/webgpu";
import type { Gaussians } from "../src/format/types.ts";
import { SH_C0 } from "../src/generated/constants.ts";

interface Kept {
  _buffers: Record<string, { value: StorageBufferAttribute & { pbo?: Texture } }>;
  _sortInitialized: boolean;
  _sphericalHarmonicsInitialized: boolean;
}

export class AirgsSplats extends Group {
  #splat: (GaussianSplat & Kept) | null = null;
  #degree = 0; // of SH

  /** Draws `gaussians` from the next picture on. Nothing is allocated while rows and SH coefficients stay as many. */
  show(gaussians: Gaussians): void {
    const rows = gaussians.alpha.length;
    const degree = rows ? Math.sqrt(gaussians.colours.length / rows / 3) - 1 : this.#degree;
    if (!this.#splat || rows > this.#splat.geometry.instanceCount || degree !== this.#degree)
      this.#allocate(rows, degree);
    const splat = this.#splat!;
    this.#fill(splat._buffers, gaussians, rows);
    splat.splatGeometry.attributes.position.array.set(gaussians.means);
    splat.boundingSphere = new Box3().setFromArray(gaussians.means).getBoundingSphere(new Sphere());
    splat._sortInitialized = false; // the depth order is to be made anew, and so are colours
    splat._sphericalHarmonicsInitialized = false;
  }

  override dispose(): void {
    this.#splat?.removeFromParent();
    this.#splat?.geometry.dispose();
    this.#splat?.material.dispose();
    this.#splat = null;
  }

  #allocate(rows: number, degree: number): void {
    this.dispose();
    const count = Math.max(rows, 1);
    const bands = [1, 2, 3].slice(0, degree).map((band) => [`sh${band}`, new Uint32Array(SH_BAND_WORDS[band] * count)]);
    const arrays = [new Float32Array(3 * count), new Float32Array(6 * count), new Uint8Array(4 * count)] as const;
    const geometry = createGaussianSplatGeometry(...arrays, Object.fromEntries(bands));
    this.#splat = new GaussianSplat(geometry) as unknown as GaussianSplat & Kept;
    this.#splat.frustumCulled = false;
    this.#degree = degree;
    this.add(this.#splat);
  }

  #fill(
    buffers: Kept["_buffers"],
    { means, quaternions: q, logScales, alpha, colours }: Gaussians,
    rows: number,
  ): void {
    const array = (name: string) => {
      const { value } = buffers[`${name}Read`];
      for (const changed of [value, value.pbo]) if (changed) changed.needsUpdate = true; // the second is for WebGL
      return value.array as Float32Array;
    };
    const [centers, left, right] = ["center", "covarianceA", "covarianceB"].map(array);
    const rgba = new Uint8ClampedArray(array("color").buffer);
    const covariance = new Float32Array(6);
    const width = 3 * (this.#degree + 1) ** 2;
    for (let i = 0, m = 0, k = 0; i < rows; i++, m += 3, k += 4) {
      const [x, y, z] = [Math.exp(logScales[m]), Math.exp(logScales[m + 1]), Math.exp(logScales[m + 2])];
      writeCovariance(covariance, 0, x, y, z, q[k + 1], q[k + 2], q[k + 3], q[k]);
      for (let c = 0; c < 4; c++) left[k + c] = covariance[c];
      for (let c = 0; c < 2; c++) right[k + c] = covariance[4 + c];
      for (let c = 0; c < 3; c++) centers[k + c] = means[m + c];
      for (let c = 0; c < 3; c++) rgba[k + c] = 255 * (SH_C0 * colours[i * width + c] + 0.5);
      rgba[k + 3] = 255 * alpha[i];
    }
    rgba.fill(0, 4 * rows);
    for (let band = 1; band <= this.#degree; band++) {
      const [first, count, step] = [3 * band ** 2, 6 * band + 3, 4 * SH_BAND_WORDS[band]];
      const bytes = new Uint8ClampedArray(array(`sphericalHarmonics${band}`).buffer);
      for (let i = 0; i < rows; i++)
        for (let c = 0; c < count; c++) bytes[i * step + c] = 128 + 128 * colours[i * width + first + c];
    }
  }
}

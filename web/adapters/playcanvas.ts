// Frames of a package as an entity of PlayCanvas 2.23 (README.md).
import * as pc from "playcanvas";
import type { Gaussians } from "../src/format/types.ts";

const TINY = 1e-30; // rows whose SH are all 0 keep those of the last frame in updateSHData (2.23)
// Where shaders of PlayCanvas differ from the renderer that packages are measured with: there a Gaussian fades to nothing
// at √8 deviations, here it ends at an alpha of 1/255; its covariance gains 0.3 squares of half a pixel, here 0.3 px².
const KERNEL: [chunk: string, theirs: string, ours: string][] = [
  ["gsplatCornerVS", "float diagonal1 = cov[0][0] + 0.3;", "float diagonal1 = cov[0][0] + 1.2;"],
  ["gsplatCornerVS", "float diagonal2 = cov[1][1] + 0.3;", "float diagonal2 = cov[1][1] + 1.2;"],
  ["gsplatPS", "return (exp(x * -4.0) - EXP4) * INV_EXP4;", "return exp(x * -4.0);"],
  ["gsplatPS", "if (A > 1.0) {", "if (A > 1.386) {"],
  ["gsplatCommonVS", "float clip = min(1.0,", "float clip = min(1.1773,"],
];

/** Sets PlayCanvas to draw all Gaussians of a scene as packages are measured, once. With WebGL 2 the kernel is changed,
 * too. Returns whether it was: sources of another version may not have the lines. */
export function tuneGsplat(app: pc.AppBase): boolean {
  const { gsplat } = app.scene;
  gsplat.dataFormat = pc.GSPLATDATA_LARGE; // 16 bits instead of 8 for scales and alpha
  gsplat.minPixelSize = 0; // small ones count
  gsplat.colorUpdateAngle = 0; // colours of SH follow the camera at once
  gsplat.useTonemap = false;
  gsplat.useFog = false;
  const { graphicsDevice: device } = app;
  const chunks = pc.ShaderChunks.get(device, pc.SHADERLANGUAGE_GLSL);
  if (device.isWebGPU || !KERNEL.every(([chunk, theirs]) => chunks.get(chunk)?.includes(theirs))) return false;
  const own = gsplat.material.getShaderChunks(pc.SHADERLANGUAGE_GLSL);
  for (const [chunk, theirs, ours] of KERNEL)
    own.set(chunk, (own.get(chunk) ?? chunks.get(chunk)!).replace(theirs, ours));
  gsplat.material.update();
  return true;
}

export class AirgsSplats {
  readonly entity = new pc.Entity("airgs");
  #data!: pc.GSplatData;
  #columns: Float32Array[] = [];
  #resource: pc.GSplatResource | null = null;

  constructor(private readonly app: pc.AppBase) {
    this.entity.addComponent("gsplat");
  }

  /** Draws `gaussians` from the next picture on. Nothing is made anew while rows and SH coefficients stay as many. */
  show(gaussians: Gaussians): void {
    const rows = gaussians.alpha.length;
    const rest = rows ? gaussians.colours.length / rows / 3 - 1 : 0;
    const old = this.#resource;
    const fits = this.#columns[0]?.length === rows && this.#columns.length === 14 + 3 * rest;
    if (!fits) this.#allocate(rows, rest);
    this.#fill(gaussians, rows, rest);
    if (fits && old) {
      old.updateColorData(this.#data);
      old.updateTransformData(this.#data);
      if (rest) old.updateSHData(this.#data);
      this.#data.calcAabb(old.aabb);
      old.centers.set(gaussians.means);
      old.centersVersion++; // the depth order is to be made anew
      this.entity.gsplat!.workBufferUpdate = pc.WORKBUFFER_UPDATE_ONCE; // so is what is drawn, else when the camera moves
    } else {
      this.#resource = new pc.GSplatResource(this.app.graphicsDevice, this.#data);
      this.entity.gsplat!.resource = this.#resource;
      old?.destroy(); // as soon as no picture needs it
    }
  }

  destroy(): void {
    this.entity.destroy();
    this.#resource?.destroy();
  }

  #allocate(rows: number, rest: number): void {
    const names = ["x", "y", "z", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3", "opacity"];
    names.push("f_dc_0", "f_dc_1", "f_dc_2", ...Array.from({ length: 3 * rest }, (_, k) => `f_rest_${k}`));
    const properties = names.map((name) => ({ type: "float", name, storage: new Float32Array(rows), byteSize: 4 }));
    this.#columns = properties.map(({ storage }) => storage);
    this.#data = new pc.GSplatData([{ name: "vertex", count: rows, properties }]);
    this.#data.activated = true; // scales and alpha, not their logarithm and logit
  }

  #fill({ means, logScales, quaternions, alpha, colours }: Gaussians, rows: number, rest: number): void {
    let done = 0; // columns
    const scatter = (from: Float32Array, count: number, width = count, first = 0, step = 1) => {
      for (let k = 0; k < count; k++) {
        const to = this.#columns[done++];
        for (let i = 0, j = first + k * step; i < rows; i++, j += width) to[i] = from[j];
      }
    };
    scatter(means, 3);
    scatter(logScales.map(Math.exp), 3);
    scatter(quaternions, 4);
    scatter(alpha, 1);
    const width = 3 * (rest + 1);
    scatter(colours, 3, width);
    for (let c = 0; c < 3; c++) scatter(colours, rest, width, 3 + c, 3); // all red ones first
    if (rest) for (const first of [this.#columns[14]]) for (let i = 0; i < rows; i++) first[i] ||= TINY;
  }
}

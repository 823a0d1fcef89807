// Frames of an AirGS package as an entity of PlayCanvas. Copy this file: it needs only `playcanvas` and the arrays that a
// reader gives.
//
//     tuneGsplat(app);                                // once
//     const splats = new AirgsSplats(app);
//     app.root.addChild(splats.entity);
//     splats.show(await reader.gaussians(frame));     // as often as you like
import * as pc from "playcanvas";
import type { Gaussians } from "../../src/airgs-frames.ts";

/**
 * Where the shaders of PlayCanvas differ from the renderer that packages are measured with. A Gaussian fades to nothing
 * at √8 standard deviations there, and ends at an alpha of 1/255 here; what is added to its covariance is 0.3 squares of
 * half a pixel there, and 0.3 px² here.
 */
const KERNEL: [chunk: string, theirs: string, ours: string][] = [
  ["gsplatCornerVS", "float diagonal1 = cov[0][0] + 0.3;", "float diagonal1 = cov[0][0] + 1.2;"],
  ["gsplatCornerVS", "float diagonal2 = cov[1][1] + 0.3;", "float diagonal2 = cov[1][1] + 1.2;"],
  ["gsplatPS", "return (exp(x * -4.0) - EXP4) * INV_EXP4;", "return exp(x * -4.0);"],
  ["gsplatPS", "if (A > 1.0) {", "if (A > 1.386) {"],
  ["gsplatCommonVS", "float clip = min(1.0,", "float clip = min(1.1773,"],
];

const TINY = 1e-30; // rows whose SH are all 0 keep those of the last frame in updateSHData (2.23)

/**
 * Sets what PlayCanvas can be set to so that it draws as packages are measured, for all Gaussians of the scene. With
 * WebGL 2 the kernel is changed as well. Returns whether it was: the sources of another version may not have the lines.
 */
export function tuneGsplat(app: pc.AppBase): boolean {
  const { gsplat } = app.scene;
  gsplat.dataFormat = pc.GSPLATDATA_LARGE; // 16 bits instead of 8 for scales and alpha
  gsplat.minPixelSize = 0; // small ones count
  gsplat.colorUpdateAngle = 0; // colours of SH follow the camera at once
  gsplat.useTonemap = false;
  gsplat.useFog = false;
  const device = app.graphicsDevice;
  if (device.isWebGPU) return false;
  const changed = new Map<string, string>();
  for (const [chunk, theirs, ours] of KERNEL) {
    const code = changed.get(chunk) ?? pc.ShaderChunks.get(device, pc.SHADERLANGUAGE_GLSL).get(chunk) ?? "";
    if (!code.includes(theirs)) return false;
    changed.set(chunk, code.replace(theirs, ours));
  }
  for (const [chunk, code] of changed) gsplat.material.getShaderChunks(pc.SHADERLANGUAGE_GLSL).set(chunk, code);
  gsplat.material.update();
  return true;
}

export class AirgsSplats {
  readonly entity = new pc.Entity("airgs");
  #data: pc.GSplatData | null = null;
  #columns: Float32Array[] = [];
  #resource: pc.GSplatResource | null = null;

  constructor(private readonly app: pc.AppBase) {
    this.entity.addComponent("gsplat");
  }

  /** Draws `gaussians` from the next picture on. Nothing is made anew while rows and SH coefficients stay as many. */
  show(gaussians: Gaussians): void {
    const rows = gaussians.alpha.length;
    const rest = rows ? gaussians.colours.length / rows / 3 - 1 : 0;
    const fits = this.#data?.numSplats === rows && this.#columns.length === 14 + 3 * rest;
    if (!fits) this.#allocate(rows, rest);
    this.#fill(gaussians, rows, rest);
    if (fits) this.#update(this.#resource!, this.#data!, gaussians.means);
    else this.#replace(new pc.GSplatResource(this.app.graphicsDevice, this.#data!));
  }

  /** Frees what is on the GPU. */
  destroy(): void {
    this.entity.destroy();
    this.#resource?.destroy();
  }

  #allocate(rows: number, rest: number): void {
    const names = ["x", "y", "z", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3", "opacity"];
    names.push("f_dc_0", "f_dc_1", "f_dc_2", ...Array.from({ length: 3 * rest }, (_, k) => `f_rest_${k}`));
    this.#columns = names.map(() => new Float32Array(rows));
    const column = (name: string, i: number) => ({ type: "float", name, storage: this.#columns[i], byteSize: 4 });
    this.#data = new pc.GSplatData([{ name: "vertex", count: rows, properties: names.map(column) }]);
    this.#data.activated = true; // scales and alpha, not their logarithm and logit
  }

  #fill(g: Gaussians, rows: number, rest: number): void {
    const stride = 3 * (rest + 1);
    const scatter = (from: Float32Array, width: number, first: number, columns: Float32Array[], step = 1) => {
      for (const [k, to] of columns.entries())
        for (let i = 0, j = first + k * step; i < rows; i++, j += width) to[i] = from[j]!;
    };
    const part = (start: number, count: number) => this.#columns.slice(start, start + count);
    scatter(g.means, 3, 0, part(0, 3));
    scatter(g.logScales, 3, 0, part(3, 3));
    for (const scales of part(3, 3)) for (let i = 0; i < rows; i++) scales[i] = Math.exp(scales[i]!);
    scatter(g.quaternions, 4, 0, part(6, 4));
    scatter(g.alpha, 1, 0, part(10, 1));
    scatter(g.colours, stride, 0, part(11, 3));
    for (let c = 0; c < 3; c++) scatter(g.colours, stride, 3 + c, part(14 + c * rest, rest), 3); // all red ones first
    for (const first of part(14, 1)) for (let i = 0; i < rows; i++) first[i] ||= TINY;
  }

  #update(resource: pc.GSplatResource, data: pc.GSplatData, means: Float32Array): void {
    resource.updateColorData(data);
    resource.updateTransformData(data);
    if (resource.shBands) resource.updateSHData(data);
    data.calcAabb(resource.aabb);
    resource.centers.set(means);
    resource.centersVersion++; // the depth order is to be made anew
  }

  #replace(resource: pc.GSplatResource): void {
    this.entity.gsplat!.resource = resource;
    this.#resource?.destroy(); // as soon as no picture needs it
    this.#resource = resource;
  }
}

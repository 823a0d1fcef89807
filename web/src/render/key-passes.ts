// The passes that make the canonical space of a group: key pictures -> row textures, once. C colour channels.
import { colourChannels, KEY_CHANNELS } from "../format/steps.ts";
import type { KeyPart } from "../format/types.ts";
import { type CodeTable, codeTable } from "./codes.ts";
import type { InUse, Programs } from "./programs.ts";
import { Samples } from "./samples.ts";
import type { Scene } from "./scene.ts";
import { KEY_GEOMETRY, keyColours, LAYERS_A_PASS, ROW_WIDTH, WHOLE } from "./shaders.ts";
import { framebuffer, type Texture } from "./textures.ts";

/** Steps of the key channels, and those of SH DC and SH rest. */
export interface KeySteps {
  steps: Float32Array;
  tintSteps: [number, number];
}

interface Tier {
  samples: Samples;
  codes: CodeTable;
  /** Rows before it in the group, and its own. */
  first: number;
  rows: number;
}

/** Colour layers of passes: [first, first + count). */
function layerRuns(degree: number): { name: string; first: number; count: number }[] {
  const layers = Math.ceil(colourChannels(degree) / 4);
  return Array.from({ length: Math.ceil(layers / LAYERS_A_PASS) }, (_, n) => {
    const first = n * LAYERS_A_PASS;
    return { name: `key colours ${degree}, ${first}`, first, count: Math.min(LAYERS_A_PASS, layers - first) };
  });
}

/** Begins to compile what `KeyPasses.run` needs; gives the names. */
export function prepareKeys(programs: Programs, degree: number): string[] {
  const samplers = ["luma", "bases", "transform"];
  programs.prepare("key geometry", () => ({ vertex: WHOLE, fragment: KEY_GEOMETRY, samplers }));
  const runs = layerRuns(degree);
  for (const { name, first, count } of runs) {
    const fragment = () => keyColours(colourChannels(degree), first, count);
    programs.prepare(name, () => ({ vertex: WHOLE, fragment: fragment(), samplers }));
  }
  return ["key geometry", ...runs.map(({ name }) => name)];
}

/** Uploads key pictures when it is made, and draws the canonical space from them when the programs are there. */
export class KeyPasses {
  readonly #gl: WebGL2RenderingContext;
  readonly #scene: Scene;
  readonly #tintSteps: [number, number];
  readonly #tiers: Tier[] = [];

  constructor(gl: WebGL2RenderingContext, scene: Scene, parts: KeyPart[], { steps, tintSteps }: KeySteps) {
    [this.#gl, this.#scene, this.#tintSteps] = [gl, scene, tintSteps];
    let first = 0;
    for (const { atlas, luma, bases } of parts) {
      const samples = new Samples(gl, atlas);
      samples.setLuma(luma);
      if (bases) samples.change(bases);
      samples.upload();
      const rows = Math.min(atlas.rows, scene.rows - first);
      this.#tiers.push({ samples, codes: codeTable(atlas, steps, KEY_CHANNELS.colours), first, rows });
      first += rows;
    }
  }

  /** Draws the row textures and lets go of the pictures. `noBases` stands in where a tier has none. */
  run(programs: Programs, noBases: Texture): void {
    const gl = this.#gl;
    const { rotations, sizes, layers, transform, degree } = this.#scene;
    gl.bindVertexArray(null);
    gl.disable(gl.BLEND);
    gl.enable(gl.SCISSOR_TEST);
    this.#pass(framebuffer(gl, [rotations, sizes]), (tier) =>
      programs.use("key geometry", [tier.samples.luma, tier.samples.bases ?? noBases, transform]),
    );
    for (const { name, first, count } of layerRuns(degree)) {
      const run = Array.from({ length: count }, (_, l) => first + l);
      const into = framebuffer(gl, new Array<Texture>(count).fill(layers), run);
      this.#pass(into, (tier) => programs.use(name, [tier.samples.luma, tier.samples.bases ?? noBases, transform]));
    }
    gl.disable(gl.SCISSOR_TEST);
    this.free();
  }

  free(): void {
    for (const { samples } of this.#tiers) samples.free();
    this.#tiers.length = 0;
  }

  /** Draws all tiers into a framebuffer, which it deletes. */
  #pass(into: WebGLFramebuffer, use: (tier: Tier) => InUse): void {
    const gl = this.#gl;
    gl.bindFramebuffer(gl.FRAMEBUFFER, into);
    gl.viewport(0, 0, ROW_WIDTH, this.#scene.places.height);
    for (const tier of this.#tiers) {
      const { at } = use(tier);
      setCodes(gl, at, tier.codes, tier.samples);
      gl.uniform2f(at("tintSteps"), ...this.#tintSteps);
      gl.uniform2i(at("span"), tier.first, tier.rows);
      const line = Math.floor(tier.first / ROW_WIDTH);
      gl.scissor(0, line, ROW_WIDTH, Math.ceil((tier.first + tier.rows) / ROW_WIDTH) - line);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    }
    gl.deleteFramebuffer(into);
  }
}

/** The uniforms of CODES and `colours` in shaders.ts. */
export function setCodes(gl: WebGL2RenderingContext, at: InUse["at"], codes: CodeTable, samples: Samples): void {
  gl.uniform2i(at("layout_"), ...codes.layout);
  gl.uniform1i(at("escaped"), samples.bases ? 1 : 0);
  gl.uniform4iv(at("entries"), codes.entries);
  gl.uniform1i(at("tintCount"), codes.tintChannels.length);
  if (!codes.tintChannels.length) return;
  gl.uniform4iv(at("tints"), codes.tints);
  gl.uniform1iv(at("tintChannels"), codes.tintChannels);
}

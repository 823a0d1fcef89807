// The passes that make the canonical space of a group: key pictures -> row textures, once. C colour channels.
import { colourChannels } from "../format/steps.ts";
import type { Atlas, KeyPart } from "../format/types.ts";
import { KEY_AT, STATE_AT } from "../generated/constants.ts";
import type { Programs, Uniforms } from "./programs.ts";
import { type CodeTable, codeTable, Samples } from "./samples.ts";
import { KEY_GEOMETRY, keyColours, LAYERS_A_PASS, ROW_WIDTH, WHOLE } from "./shaders.ts";
import { framebuffer, type Texture } from "./textures.ts";

/** The canonical space of a group as row textures, into which the passes draw. */
export interface RowTextures {
  readonly rows: number;
  readonly degree: number;
  readonly places: Texture;
  readonly rotations: Texture;
  readonly sizes: Texture;
  readonly layers: Texture;
}

/** What the key channels of a group count in: their steps, those of differences, those of SH DC and SH rest, and the
 * colour transform.
 */
export interface KeyCoding {
  steps: Float32Array;
  /** ln of the unit of the grid, in which log-scales are coded. */
  unit: number;
  differenceSteps: Float32Array;
  tintSteps: [number, number];
  transform: Texture;
}

interface Part {
  /** The key, then what is added to it; no samples: codes of 0. */
  pictures: { samples: Samples | null; codes: CodeTable }[];
  /** Rows before it in the group, and its own. */
  first: number;
  rows: number;
}

const SAMPLERS = ["luma", "bases", "luma2", "bases2", "transform"];

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
  programs.prepare("key geometry", () => ({ vertex: WHOLE, fragment: KEY_GEOMETRY, samplers: SAMPLERS }));
  const runs = layerRuns(degree);
  for (const { name, first, count } of runs) {
    const fragment = () => keyColours(colourChannels(degree), first, count);
    programs.prepare(name, () => ({ vertex: WHOLE, fragment: fragment(), samplers: SAMPLERS }));
  }
  return ["key geometry", ...runs.map(({ name }) => name)];
}

/** Uploads key pictures when it is made, and draws the canonical space from them when the programs are there. */
export class KeyPasses {
  readonly #parts: Part[] = [];

  constructor(
    private readonly gl: WebGL2RenderingContext,
    private readonly into: RowTextures,
    parts: KeyPart[],
    private readonly coding: KeyCoding,
  ) {
    let first = 0;
    const upload = ({ atlas, luma, bases }: KeyPart) => {
      const samples = new Samples(gl, atlas);
      samples.setLuma(luma);
      if (bases) samples.change(bases);
      samples.upload();
      return samples;
    };
    for (const part of parts) {
      const { atlas, factor, difference } = part;
      const read = (key: KeyPart | null, of: Atlas, steps: Float32Array, colour: number) => {
        const scaled = steps.map((step) => step * factor);
        return { samples: key && upload(key), codes: codeTable(of, scaled, colour) };
      };
      const none = { ...atlas, centres: [...coding.differenceSteps].fill(0), planes: [] };
      const own = read(part, atlas, coding.steps, KEY_AT.colour);
      const added = read(difference, difference?.atlas ?? none, coding.differenceSteps, STATE_AT.colour);
      this.#parts.push({ pictures: [own, added], first, rows: atlas.rows });
      first += atlas.rows;
    }
  }

  /** Draws the row textures and lets go of the pictures. `noLuma` and `noBases` stand in where a tier has none. */
  run(programs: Programs, noLuma: Texture, noBases: Texture): void {
    const { gl } = this;
    const { rotations, sizes, layers, degree } = this.into;
    const textures = ({ pictures }: Part) => [
      ...pictures.flatMap(({ samples }) => [samples?.luma ?? noLuma, samples?.bases ?? noBases]),
      this.coding.transform,
    ];
    gl.bindVertexArray(null);
    gl.disable(gl.BLEND);
    gl.enable(gl.SCISSOR_TEST);
    this.#pass(framebuffer(gl, [rotations, sizes]), (part) => programs.use("key geometry", textures(part)));
    for (const { name, first, count } of layerRuns(degree)) {
      const run = Array.from({ length: count }, (_, l) => first + l);
      const target = framebuffer(gl, new Array<Texture>(count).fill(layers), run);
      this.#pass(target, (part) => programs.use(name, textures(part)));
    }
    gl.disable(gl.SCISSOR_TEST);
    this.free();
  }

  free(): void {
    for (const { pictures } of this.#parts) for (const { samples } of pictures) samples?.free();
    this.#parts.length = 0;
  }

  /** Draws all parts into a framebuffer, which it deletes. */
  #pass(into: WebGLFramebuffer, use: (part: Part) => Uniforms): void {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, into);
    gl.viewport(0, 0, ROW_WIDTH, this.into.places.height);
    for (const part of this.#parts) {
      const at = use(part);
      const { pictures, first, rows } = part;
      pictures.forEach(({ codes, samples }, n) => {
        setCodes(gl, (name) => at(name + (n ? 2 : "")), codes, samples);
      });
      gl.uniform2f(at("tintSteps"), ...this.coding.tintSteps);
      gl.uniform1f(at("unit"), this.coding.unit);
      gl.uniform2i(at("span"), first, rows);
      const line = Math.floor(first / ROW_WIDTH);
      gl.scissor(0, line, ROW_WIDTH, Math.ceil((first + rows) / ROW_WIDTH) - line);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    }
    gl.deleteFramebuffer(into);
  }
}

/** The uniforms of CODES and `colours` in shaders.ts. */
export function setCodes(gl: WebGL2RenderingContext, at: Uniforms, codes: CodeTable, samples: Samples | null): void {
  gl.uniform2i(at("layout_"), ...codes.layout);
  gl.uniform1i(at("escaped"), samples?.bases ? 1 : 0);
  gl.uniform4iv(at("entries"), codes.entries);
  gl.uniform1i(at("tintCount"), codes.tintChannels.length);
  if (!codes.tintChannels.length) return;
  gl.uniform4iv(at("tints"), codes.tints);
  gl.uniform1iv(at("tintChannels"), codes.tintChannels);
}

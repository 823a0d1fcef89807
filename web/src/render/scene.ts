// What the GPU holds of a group: the canonical space, which passes over keyframe pictures draw once, the picture of a state,
// an order. N rows, C colour channels.
//
// A row takes 88 bytes and 16 for each four colours: 280 with spherical harmonics of degree 3.
import { colourChannels, colourMatrix, deltaSteps, differenceSteps, gridUnit, keyframeSteps } from "../format/steps.ts";
import type { Atlas, BaseChanges, Canonical, Group, KeyframePart, Root } from "../format/types.ts";
import { DELTA_AT, KEYFRAME_AT, STATIC } from "../generated/constants.ts";
import type { Programs, Uniforms } from "./programs.ts";
import { type CodeTable, codeTable, Samples } from "./samples.ts";
import { KEYFRAME_GEOMETRY, keyframeColours, LAYERS_A_PASS, ROW_WIDTH, WHOLE } from "./shaders.ts";
import { framebuffer, RenderError, type Texture, texture, write, writeRows } from "./textures.ts";

const NO_RANK = 0xffffffff;

interface LevelView {
  readonly level: number;
  readonly atlas: Atlas;
  readonly samples: Samples;
  readonly codes: CodeTable;
}

interface Part {
  /** The keyframe, then what is added to it; no samples: codes of 0. */
  pictures: { samples: Samples | null; codes: CodeTable }[];
  first: number;
  rows: number;
}

const SAMPLERS = ["luma", "bases", "luma2", "bases2", "transform"];

/** Colour layers of passes: [first, first + count). */
function layerRuns(degree: number): { name: string; first: number; count: number }[] {
  const layers = Math.ceil(colourChannels(degree) / 4);
  return Array.from({ length: Math.ceil(layers / LAYERS_A_PASS) }, (_, n) => {
    const first = n * LAYERS_A_PASS;
    return { name: `keyframe colours ${degree}, ${first}`, first, count: Math.min(LAYERS_A_PASS, layers - first) };
  });
}

/** Begins to compile what `KeyframePasses.run` needs; gives the names. */
export function prepareKeyframes(programs: Programs, degree: number): string[] {
  programs.prepare("keyframe geometry", () => ({ vertex: WHOLE, fragment: KEYFRAME_GEOMETRY, samplers: SAMPLERS }));
  const runs = layerRuns(degree);
  for (const { name, first, count } of runs) {
    const fragment = () => keyframeColours(colourChannels(degree), first, count);
    programs.prepare(name, () => ({ vertex: WHOLE, fragment: fragment(), samplers: SAMPLERS }));
  }
  return ["keyframe geometry", ...runs.map(({ name }) => name)];
}

/** Uploads keyframe pictures when it is made, and draws the canonical space from them when the programs are there. */
class KeyframePasses {
  readonly #parts: Part[] = [];

  constructor(
    private readonly gl: WebGL2RenderingContext,
    private readonly into: Scene,
    root: Root,
    private readonly group: Group,
    { parts, quality }: Canonical,
  ) {
    const [steps, changes] = [keyframeSteps(root, group, quality), differenceSteps(root, group, quality)];
    let first = 0;
    for (const part of parts) {
      const { atlas, factor, difference } = part;
      const read = (keyframe: KeyframePart | null, of: Atlas, steps: Float32Array, colour: number) => {
        const scaled = steps.map((step) => step * factor);
        return { samples: keyframe && uploaded(gl, keyframe), codes: codeTable(of, scaled, colour) };
      };
      const none = { ...atlas, centres: [...changes].fill(0), planes: [] };
      const own = read(part, atlas, steps, KEYFRAME_AT.colour);
      const added = read(difference, difference?.atlas ?? none, changes, DELTA_AT.colour);
      this.#parts.push({ pictures: [own, added], first, rows: atlas.rows });
      first += atlas.rows;
    }
  }

  /** Draws the row textures and lets go of the pictures. `noLuma` and `noBases` stand in where a tier has none. */
  run(programs: Programs, noLuma: Texture, noBases: Texture): void {
    const { gl } = this;
    const { rotations, sizes, layers, degree, transform } = this.into;
    const textures = ({ pictures }: Part) => [
      ...pictures.flatMap(({ samples }) => [samples?.luma ?? noLuma, samples?.bases ?? noBases]),
      transform,
    ];
    gl.bindVertexArray(null);
    gl.disable(gl.BLEND);
    gl.enable(gl.SCISSOR_TEST);
    this.#pass(framebuffer(gl, [rotations, sizes]), (part) => programs.use("keyframe geometry", textures(part)));
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
      gl.uniform2f(at("tintSteps"), ...tintSteps(this.group.keyframe_steps));
      gl.uniform1f(at("unit"), Math.log(gridUnit(this.group)));
      gl.uniform2i(at("span"), first, rows);
      const line = Math.floor(first / ROW_WIDTH);
      gl.scissor(0, line, ROW_WIDTH, Math.ceil((first + rows) / ROW_WIDTH) - line);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    }
    gl.deleteFramebuffer(into);
  }
}

function uploaded(gl: WebGL2RenderingContext, { atlas, luma, bases }: KeyframePart): Samples {
  const samples = new Samples(gl, atlas);
  samples.setLuma(luma);
  if (bases) samples.change(bases);
  samples.upload();
  return samples;
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

/** A group on the GPU, in a keyframe quality. Made by `Renderer.scene`, released by `Renderer.free`. */
export class Scene {
  readonly rows: number;
  readonly degree: number;
  readonly places: Texture;
  readonly rotations: Texture;
  readonly sizes: Texture;
  readonly ranks: Texture;
  readonly layers: Texture;
  readonly transform: Texture;
  readonly order: Texture;
  readonly firsts: Texture;
  readonly seconds: Texture;
  readonly projection: WebGLFramebuffer;
  readonly tintSteps: [number, number];
  /** Passes that have yet to run; null: the canonical space is there. */
  keyframes: KeyframePasses | null;
  /** The level of the picture that is shown. */
  shown: LevelView | null = null;
  /** Whether `shown` has a picture, or the canonical space is shown. */
  moving = false;
  /** How often slopes count in that picture. */
  time = 0;
  visible = 0;
  ordered = false;
  /** Camera of what is in `firsts` and `seconds`; null: out of date. */
  projectedFor: string | null = null;
  freed = false;
  #next: LevelView | null = null;

  constructor(
    private readonly gl: WebGL2RenderingContext,
    private readonly root: Root,
    private readonly group: Group,
    private readonly canonical: Canonical,
  ) {
    this.rows = canonical.depths.length;
    this.degree = root.sh_degree;
    const channels = colourChannels(root.sh_degree);
    const layers = Math.ceil(channels / 4);
    const size = rowSize(gl, this.rows);
    this.places = texture(gl, "RGBA32UI", size);
    this.rotations = texture(gl, "RGBA32UI", size);
    this.sizes = texture(gl, "RGBA32UI", size);
    this.ranks = texture(gl, "R32UI", size);
    this.layers = texture(gl, "RGBA32UI", size, layers);
    this.transform = transformOf(gl, group, channels);
    this.order = texture(gl, "R32UI", size);
    this.firsts = texture(gl, "RGBA32UI", size);
    this.seconds = texture(gl, "RGBA32UI", size);
    this.projection = framebuffer(gl, [this.firsts, this.seconds]);
    writeRows(gl, this.places, interleave(canonical), 4);
    this.tintSteps = tintSteps(group.delta_steps);
    this.keyframes = new KeyframePasses(gl, this, root, group, canonical);
  }

  get #gone(): boolean {
    return this.freed || this.gl.isContextLost();
  }

  /** A segment of a level begins: its bases are 0, and so are slopes. What is drawn stays until `delta`. */
  begin(level: number): void {
    if (this.#gone) return;
    if (this.#coming?.level === level) {
      this.#coming.samples.reset();
      return;
    }
    this.#drop();
    const atlas = this.group.levels[level];
    const codes = codeTable(atlas, deltaSteps(this.root, this.group, level), DELTA_AT.colour);
    this.#next = { level, atlas, codes, samples: new Samples(this.gl, atlas) };
  }

  /** Base changes of the next picture of the segment, whether it is shown or dropped. */
  change(bases: BaseChanges): void {
    if (!this.#gone) this.#coming?.samples.change(bases);
  }

  get #coming(): LevelView | null {
    return this.#next ?? this.shown;
  }

  /** The picture that is shown from now on, with slopes at a time: luma of all pages of the level's atlas, whose bases
   * were told before; null: the canonical space. Throws RenderError for a picture of another atlas.
   */
  delta(atlas: Atlas, luma: Uint8Array | null, time = 0): void {
    if (this.#gone) return;
    const view = this.#coming;
    if (luma && view?.atlas !== atlas) {
      throw new RenderError(`a delta: expected ${view ? `level ${view.level}` : "a level first"}, got another`);
    }
    this.projectedFor = null;
    this.moving = luma !== null;
    this.time = time;
    if (!luma || !view) return;
    view.samples.setLuma(luma);
    view.samples.upload();
    if (view === this.shown) return;
    this.shown?.samples.free();
    [this.shown, this.#next] = [view, null];
    writeRows(this.gl, this.ranks, ranksOf(this.canonical.depths, view.level));
  }

  /** Rows far to near, as `Sorter` gives them. Throws RenderError for more than there are. */
  sort(rows: Uint32Array): void {
    if (this.#gone) return;
    if (rows.length > this.rows) {
      throw new RenderError(`an order: expected at most ${this.rows} rows, got ${rows.length}`);
    }
    writeRows(this.gl, this.order, rows);
    this.visible = rows.length;
    this.ordered = true;
  }

  free(): void {
    if (this.freed) return;
    this.freed = true;
    const { gl } = this;
    const own = [this.places, this.rotations, this.sizes, this.ranks, this.layers, this.transform, this.order];
    for (const { handle } of [...own, this.firsts, this.seconds]) gl.deleteTexture(handle);
    gl.deleteFramebuffer(this.projection);
    this.keyframes?.free();
    this.shown?.samples.free();
    this.#drop();
  }

  #drop(): void {
    this.#next?.samples.free();
    this.#next = null;
  }
}

function rowSize(gl: WebGL2RenderingContext, rows: number): [number, number] {
  const side: number | null = gl.getParameter(gl.MAX_TEXTURE_SIZE); // null: the context was lost
  const height = Math.max(1, Math.ceil(rows / ROW_WIDTH));
  if (side === null || (ROW_WIDTH <= side && height <= side)) return [ROW_WIDTH, height];
  const most = ROW_WIDTH <= side ? side * ROW_WIDTH : 0;
  throw new RenderError(`a group: expected at most ${most} Gaussians on this machine, got ${rows}`);
}

function interleave({ means, units }: Canonical): Uint32Array {
  const places = new Float32Array(4 * units.length);
  for (let i = 0, at = 0, from = 0; i < units.length; i++) {
    places[at++] = means[from++];
    places[at++] = means[from++];
    places[at++] = means[from++];
    places[at++] = units[i];
  }
  return new Uint32Array(places.buffer);
}

function transformOf(gl: WebGL2RenderingContext, group: Group, channels: number): Texture {
  const width = Math.ceil(channels / 4);
  const matrix = colourMatrix(group, channels);
  const lines = new Float32Array(4 * width * channels);
  for (let k = 0; k < channels; k++) lines.set(matrix.subarray(k * channels, (k + 1) * channels), 4 * width * k);
  const made = texture(gl, "RGBA32F", [width, channels]);
  write(gl, made, { y: 0, width, height: channels }, lines);
  return made;
}

function ranksOf(depths: Uint8Array, level: number): Uint32Array {
  let next = 0;
  return Uint32Array.from(depths, (depth) => (depth >= level && depth !== STATIC ? next++ : NO_RANK));
}

/** Steps of SH DC and SH rest. */
const tintSteps = (steps: { sh_dc: number; sh_rest: number }): [number, number] => [steps.sh_dc, steps.sh_rest];

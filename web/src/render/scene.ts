// What the GPU holds of a group: the canonical space, the picture of a state, an order. N rows, C colour channels.
//
// A row takes 88 bytes and 16 for each four colours: 280 with spherical harmonics of degree 3.
import {
  colourChannels,
  colourMatrix,
  colourSteps,
  differenceSteps,
  gridUnit,
  keySteps,
  stateSteps,
} from "../format/steps.ts";
import type { Atlas, BaseChanges, Canonical, Group, Root } from "../format/types.ts";
import { STATE_AT, STATIC } from "../generated/constants.ts";
import { KeyPasses } from "./key-passes.ts";
import { type CodeTable, codeTable, Samples } from "./samples.ts";
import { ROW_WIDTH } from "./shaders.ts";
import { framebuffer, RenderError, type Texture, texture, write, writeRows } from "./textures.ts";

const NO_RANK = 0xffffffff;

export interface LevelView {
  readonly level: number;
  readonly atlas: Atlas;
  readonly samples: Samples;
  readonly codes: CodeTable;
}

/** A group on the GPU, in a key quality. Made by `Renderer.scene`, released by `Renderer.free`. */
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
  /** Steps of SH DC and SH rest in states. */
  readonly tintSteps: [number, number];
  /** Passes that have yet to run; null: the canonical space is there. */
  keys: KeyPasses | null;
  /** The level of the picture that is shown, if one is. */
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
  /** The level of the pictures that come next. */
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
    this.tintSteps = dcAndRest(group.state_steps, channels);
    const coding = {
      steps: keySteps(root, group, canonical.quality),
      unit: Math.log(gridUnit(group)),
      differenceSteps: differenceSteps(root, group, canonical.quality),
      tintSteps: dcAndRest(group.key_steps, channels),
      transform: this.transform,
    };
    this.keys = new KeyPasses(gl, this, canonical.parts, coding);
  }

  /** Whether nothing can be changed any more: it was released, or the context was lost. */
  get #gone(): boolean {
    return this.freed || this.gl.isContextLost();
  }

  /** A segment of a level begins: its bases are 0, and so are slopes. What is drawn stays until `state`. */
  begin(level: number): void {
    if (this.#gone) return;
    if (this.#coming?.level === level) {
      this.#coming.samples.reset();
      return;
    }
    this.#drop();
    const atlas = this.group.levels[level];
    const codes = codeTable(atlas, stateSteps(this.root, this.group, level), STATE_AT.colour);
    this.#next = { level, atlas, codes, samples: new Samples(this.gl, atlas) };
  }

  /** Base changes of the next picture of the segment, whether it is shown or dropped. */
  change(bases: BaseChanges): void {
    if (!this.#gone) this.#coming?.samples.change(bases);
  }

  /** The level that pictures are of. */
  get #coming(): LevelView | null {
    return this.#next ?? this.shown;
  }

  /** The picture that is shown from now on, with slopes at a time: luma of all pages of the level's atlas, whose bases
   * were told before. null: the canonical space, where a level has no picture. Throws RenderError for a picture of another atlas.
   */
  state(atlas: Atlas, luma: Uint8Array | null, time = 0): void {
    if (this.#gone) return;
    const view = this.#coming;
    if (luma && view?.atlas !== atlas) {
      throw new RenderError(`a state: expected ${view ? `level ${view.level}` : "a level first"}, got another`);
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
    this.keys?.free();
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

/** Mean and motion unit of each row, as bits. */
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

/** The place of each row among those that a level carries. */
function ranksOf(depths: Uint8Array, level: number): Uint32Array {
  let next = 0;
  return Uint32Array.from(depths, (depth) => (depth >= level && depth !== STATIC ? next++ : NO_RANK));
}

function dcAndRest(steps: { sh_dc: number; sh_rest: number }, channels: number): [number, number] {
  const all = colourSteps(steps, channels);
  return [all[0], all[channels - 1]];
}

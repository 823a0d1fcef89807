// Segments: a state file over a canonical space -> luma, bases and means of each frame. N rows of a tile, n of a level.
import { planeCorner, planeHeight, rowOffsets } from "../format/atlas.ts";
import type { Tables } from "../format/package.ts";
import { stateSteps } from "../format/steps.ts";
import type { Atlas, BaseChanges, StateFrame } from "../format/types.ts";
import { checkCount, levelRows, readStateUnit } from "../format/units.ts";
import { BLOCK, ESCAPE_UNIT, GREY } from "../generated/constants.ts";
import type { DecodeOptions } from "./decoder.ts";
import type { PictureDecoder } from "./pictures.ts";
import type { Positions } from "./spaces.ts";

const AXES = 3; // the first state channels: means

/** A state file and the canonical space that it changes. */
export interface StateFile {
  /** Segment and group, counted from 0. */
  segment: number;
  group: number;
  level: number;
  tile: number;
  /** How many key tiers of the tile `positions` has. */
  tiers: number;
  positions: Positions;
  bytes: Uint8Array;
  where: string;
}

/** Decodes a state file frame by frame. Throws FormatError. */
export async function decodeStates(
  tables: Tables,
  file: StateFile,
  decoder: PictureDecoder,
  take: (t: number, frame: StateFrame) => void,
  options: DecodeOptions,
): Promise<void> {
  const { segment, group, tile, level, where } = file;
  const table = tables.group(group);
  checkCount(tables.root, table, level, file, file.positions.depths);
  const place = segment - tables.segmentsOf(group).start;
  const { atlas, frames, pages, bases } = readStateUnit(table, { segment, place, tile, level }, file.bytes);
  const means = new Means(file, atlas, stateSteps(tables.root, table, level));
  const show = (t: number, luma: Uint8Array) => {
    const changes = bases.next(t);
    take(t, { luma, bases: changes, means: means.next(luma, changes) });
  };
  await decoder.decode({ pages, atlas, frames, where }, show, options);
}

/** Means from frame to frame: what the depth order is made of. */
class Means {
  readonly #positions: Positions;
  readonly #rows: Uint32Array;
  readonly #offsets: Uint32Array;
  /** Bases other than 0 of samples of means, by AXES · i + axis. */
  readonly #bases = new Map<number, number>();

  constructor(
    { positions, level }: StateFile,
    readonly atlas: Atlas,
    readonly steps: Float32Array,
  ) {
    this.#positions = positions;
    this.#rows = levelRows(positions.depths, level);
    this.#offsets = rowOffsets(atlas);
  }

  /** (3N) means of the picture that follows the one before. */
  next(luma: Uint8Array, changes: BaseChanges | null): Float32Array {
    for (const [e, texel] of changes?.texels.entries() ?? []) this.#change(texel, changes?.bases[e] ?? 0);
    const means = this.#positions.means.slice();
    for (let axis = 0; axis < AXES; axis++) this.#move(means, axis, luma);
    for (const [sample, base] of this.#bases)
      this.#add(means, Math.floor(sample / AXES), sample % AXES, ESCAPE_UNIT * base);
    return means;
  }

  #move(means: Float32Array, axis: number, luma: Uint8Array): void {
    const centre = this.atlas.centres[axis];
    const plane = this.atlas.planes.indexOf(axis);
    if (plane < 0 && !centre) return;
    const corner = plane < 0 ? 0 : planeCorner(this.atlas, plane);
    for (let i = 0; i < this.#rows.length; i++) {
      this.#add(means, i, axis, plane < 0 ? centre : luma[corner + this.#offsets[i]] - GREY + centre);
    }
  }

  /** Adds a code to the mean of the i-th row of the level. */
  #add(means: Float32Array, i: number, axis: number, code: number): void {
    const row = this.#rows[i];
    means[AXES * row + axis] += Math.fround(code * this.steps[axis]) * this.#positions.units[row];
  }

  /** A sample has another base from now on, which matters if it is one of a mean, of a row that is here. */
  #change(texel: number, base: number): void {
    const { width, plane_width, rows, columns, planes } = this.atlas;
    const [x, y] = [texel % width, Math.floor(texel / width)];
    const lines = planeHeight(rows, plane_width);
    const axis = planes[Math.floor(y / lines) * columns + Math.floor(x / plane_width)];
    const i = rowAt(x % plane_width, y % lines, plane_width);
    if (axis < AXES && i < this.#rows.length) this.#bases.set(AXES * i + axis, base);
  }
}

/** The row whose sample lies at column x and line y of a plane. */
function rowAt(x: number, y: number, planeWidth: number): number {
  const block = Math.floor(y / BLOCK) * (planeWidth / BLOCK) + Math.floor(x / BLOCK);
  return block * BLOCK * BLOCK + spread(x % BLOCK) + 2 * spread(y % BLOCK);
}

/** The four bits of a number in the even places of another. */
const spread = (bits: number) => (bits & 1) | ((bits & 2) << 1) | ((bits & 4) << 2) | ((bits & 8) << 3);

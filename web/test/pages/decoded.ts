// What tests/support/decoded.py writes: a package as the renderer takes it, and what every camera is to see.
import type { BaseChanges, Camera, Canonical, Group, KeyframePart, Root } from "../../src/format/types.ts";

const TYPES = { uint8: Uint8Array, uint32: Uint32Array, int32: Int32Array, float32: Float32Array };
type Reference = [keyof typeof TYPES, number, number];

interface PictureTable {
  luma: Reference | null;
  changes: { texels: Reference; bases: Reference; slopes?: Reference | null } | null;
}

interface FrameTable extends PictureTable {
  time: number;
  means: Reference;
  pictures: Reference[];
}

interface PartTable extends PictureTable {
  tier: number;
  difference: PictureTable | null;
}

interface RungTable {
  quality: number;
  level: number;
  tiers: number;
  groups: {
    canonical: { means: Reference; units: Reference; depths: Reference; parts: PartTable[] };
    segments: FrameTable[][];
  }[];
}

interface Table {
  root: Root;
  groups: Group[];
  cameras: (Omit<Camera, "worldToCamera"> & { worldToCamera: number[] })[];
  rungs: RungTable[];
}

export interface Frame {
  luma: Uint8Array | null;
  changes: BaseChanges | null;
  time: number;
  means: Float32Array;
  /** (3 · width · height) r, g, b of each camera on black, not clipped. */
  pictures: Float32Array[];
}

export interface Rung {
  quality: number;
  level: number;
  groups: { group: Group; canonical: Canonical; segments: Frame[][] }[];
}

export class Decoded {
  readonly root: Root;
  readonly cameras: Camera[];
  readonly rungs: Rung[];
  readonly #data: ArrayBuffer;

  private constructor({ root, groups, cameras, rungs }: Table, data: ArrayBuffer) {
    this.root = root;
    this.#data = data;
    this.cameras = cameras.map((camera) => ({ ...camera, worldToCamera: Float64Array.from(camera.worldToCamera) }));
    this.rungs = rungs.map((rung) => ({
      ...rung,
      groups: rung.groups.map(({ segments }, g) => ({
        group: groups[g],
        canonical: this.#canonical(rung, g, groups),
        segments: segments.map((frames) => frames.map((frame) => this.#frame(frame))),
      })),
    }));
  }

  static async fetch(name: string): Promise<Decoded> {
    const [table, data] = await Promise.all([fetch(`${name}.json`), fetch(`${name}.bin`)]);
    return new Decoded(await table.json(), await data.arrayBuffer());
  }

  #array<T extends ArrayBufferView>([type, at, count]: Reference): T {
    return new TYPES[type](this.#data, at, count) as unknown as T;
  }

  #changes(table: PictureTable): BaseChanges | null {
    if (!table.changes) return null;
    const { texels, bases, slopes } = table.changes;
    return { texels: this.#array(texels), bases: this.#array(bases), slopes: slopes ? this.#array(slopes) : null };
  }

  #frame(table: FrameTable): Frame {
    return {
      luma: table.luma && this.#array<Uint8Array>(table.luma),
      changes: this.#changes(table),
      time: table.time,
      means: this.#array(table.means),
      pictures: table.pictures.map((picture) => this.#array<Float32Array>(picture)),
    };
  }

  #canonical({ quality, tiers, groups }: RungTable, group: number, tables: Group[]): Canonical {
    const { means, units, depths, parts } = groups[group].canonical;
    return {
      ...{ group, quality, tiers },
      means: this.#array(means),
      units: this.#array(units),
      depths: this.#array(depths),
      parts: parts.map((part) => {
        const { base } = tables[group];
        const key = (picture: PictureTable, number: number, difference: KeyframePart | null): KeyframePart => {
          const { qualities, factor } = tables[number].tiers[part.tier];
          const luma = this.#array<Uint8Array>(picture.luma!);
          return { atlas: qualities[quality], factor, luma, bases: this.#changes(picture), difference };
        };
        const difference = part.difference && key(part.difference, group, null);
        return key(part, base ? base - 1 : group, difference);
      }),
    };
  }
}

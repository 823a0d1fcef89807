// What decoded things look like on their way from files to pictures. N rows of a group, C colour channels.
import type { group, page, root } from "../generated/schema.ts";

/** The values that a schema describes; every table says what it may lack. */
type Of<S> = S extends { const: infer Value }
  ? Value
  : S extends { enum: readonly (infer Value)[] }
    ? Value
    : S extends { items: infer Item }
      ? Of<Item>[]
      : S extends { additionalProperties: infer Value extends object }
        ? Record<string, Of<Value>>
        : S extends { properties: infer Fields }
          ? { [Name in Exclude<keyof Fields, Optional<S>>]: Of<Fields[Name]> } & {
              [Name in Extract<keyof Fields, Optional<S>>]?: Of<Fields[Name]>;
            }
          : S extends { type: "string" }
            ? string
            : S extends { type: "boolean" }
              ? boolean
              : number;

type Optional<S> = S extends { optional: readonly (infer Name)[] } ? Name : never;

// FORMAT.md, section 2, says what each field is.
export type Root = Of<typeof root>;
export type Page = Of<typeof page>;
export type Group = Of<typeof group>;
export type Region = Root["region"];
export type Place = Region["places"][number];
export type World = NonNullable<Root["world"]>;
export type FileEntry = Root["init"];
export type Grid = Group["grid"];
export type Atlas = Group["levels"][number];
export type Segment = Group["segments"][number];

/** Samples whose base changes with a picture (FORMAT.md, section 6), and what it is from then on. */
export interface BaseChanges {
  /** Places in the atlas: line · width + column, pages one after the other. */
  texels: Uint32Array;
  bases: Int32Array;
  /** (samples) codes of slopes, with the first picture of a segment that has slopes. */
  slopes?: Int32Array | null | undefined;
}

/** The keyframe picture of a tier, of the base where there is one. */
export interface KeyframePart {
  atlas: Atlas;
  /** On the keyframe steps of its group, beside that of the keyframe quality. */
  factor: number;
  /** Samples of all pages, one after the other, each `atlas.width` × `atlas.height`. */
  luma: Uint8Array;
  bases: BaseChanges | null;
  /** What the group differs by; null: by nothing but means. */
  difference: KeyframePart | null;
}

export interface CanonicalName {
  group: number;
  quality: number;
  /** How many keyframe tiers, from the first on; one without rows has no file. */
  tiers: number;
}

/** The canonical space of a group in a keyframe quality, as far as tiers were fetched. */
export interface Canonical extends CanonicalName {
  /** (3N) canonical means, world units. */
  means: Float32Array;
  /** (N) motion unit 2^c of each row, world units. */
  units: Float32Array;
  /** (N) deepest level that carries a row's updates; 255: static. */
  depths: Uint8Array;
  parts: KeyframePart[]; // in the order of rows
}

export interface DeltaFrame {
  /** Samples of all pages, one after the other. */
  luma: Uint8Array;
  /** What changes from the frame before in the segment, or from bases of 0; null: nothing. */
  bases: BaseChanges | null;
  /** x: how often slopes count (FORMAT.md, section 4); 0 without slopes. */
  time: number;
  /** (3N) means of all rows in this frame, world units: what the depth order is made of. */
  means: Float32Array;
}

/** N Gaussians as they are shown. */
export interface Gaussians {
  means: Float32Array; // (3N) world units
  /** (4N) w, x, y, z, of length 1. */
  quaternions: Float32Array;
  logScales: Float32Array; // (3N) ln of world units
  alpha: Float32Array; // (N) 0 … 1
  /** (N · C) r, g, b of SH DC, then of each coefficient of SH rest. */
  colours: Float32Array;
}

/** A view as OpenCV has it: x right, y down, z ahead; pixels are square. */
export interface Camera {
  width: number;
  height: number;
  fx: number;
  fy: number;
  cx: number;
  cy: number;
  /** What is nearer than this along z is not drawn. */
  near: number;
  worldToCamera: Float64Array; // (16) row by row
}

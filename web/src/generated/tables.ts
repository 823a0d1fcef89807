// Made by python -m tools.typescript from airgs_codec.package.tables, which says what each field is.

/** airgs.json. */
export interface Root {
  version: number;
  generator: Generator;
  attribution: string;
  decisions: string[];
  frame_rate: number[];
  timescale: number;
  frames: number;
  live: boolean;
  sh_degree: number;
  key_gain: number;
  state_gain: number;
  region: Region;
  world?: World;
  views: Views;
  qualities: KeyQuality[];
  levels: Level[];
  tiers: number;
  tiles: number;
  init: FileEntry;
  index: Spans[];
}

/** Parts of a sequence that follow each other, in columns: groups, or pages of one level. */
export interface Spans {
  frames: number[];
  segments: number[];
  bytes: number[];
  sha256: string;
}

/** Frames [start, stop) that share a canonical space: the table group/{n}.json.gz. */
export interface Group {
  start: number;
  stop: number;
  count: number;
  static: number;
  unused: number;
  grid: Grid;
  key_steps: KeySteps;
  state_steps: StateSteps;
  colour_transform: string;
  tiles: GroupTile[];
  segments: Segment[];
  left_out: LeftOut[];
  repairs: string[];
  keeps?: number;
}

/** Who wrote the package and with what. */
export interface Generator {
  version: string;
  libraries: Record<string, string>;
  settings: Record<string, string>;
}

/** Where the scene may be looked at from: in the ball of a place, at most `turn` off the direction to its focus. */
export interface Region {
  source: "cameras" | "found" | "orbit" | "file";
  width: number;
  height: number;
  fov_y: number;
  near: number;
  turn: number;
  places: Place[];
  background?: number[];
}

/** Where the scene stands in a right-handed world with y up, as that of glTF: for players, not for decoders. */
export interface World {
  transform: number[];
  metric: boolean;
}

/** How many pictures were looked at. */
export interface Views {
  decided: number;
  measured: number;
  reference: "original" | "none";
}

/** A quality of the key: steps multiplied by `factor`, the sides of the cells of canonical means by 2^coarser. */
export interface KeyQuality {
  id: string;
  factor: number;
  coarser: number;
}

/** A pruning level: which share of the moving rows is withheld at least, and the step factor of the others. */
export interface Level {
  id: string;
  pruned: number;
  factor: number;
  tiers: number;
  quality: number;
}

/** Length and digest of a file; 0 and no digest where there is no file. */
export interface FileEntry {
  bytes: number;
  sha256: string;
}

/** Nested cubic cells of canonical means: a row of motion class c lies in the middle of a cell of step 2^k. */
export interface Grid {
  origin: number[];
  step: number;
  bits: number;
  finest: number;
}

/** Quantiser steps of the key at factor 1. */
export interface KeySteps {
  quaternions: number;
  log_scales: number;
  opacity: number;
  sh_dc: number;
  sh_rest: number;
}

/** Quantiser steps of the state at factor 1. */
export interface StateSteps {
  means: number;
  quaternions: number;
  log_scales: number;
  opacity: number;
  sh_dc: number;
  sh_rest: number;
}

/** The rows of one group in one part of space, which are fetched and decoded apart from all others. */
export interface GroupTile {
  low: number[];
  high: number[];
  tiers: GroupTier[];
  levels: Atlas[];
}

/** Frames [start, stop) of a group, fetched and decoded together. */
export interface Segment {
  start: number;
  stop: number;
  levels: SegmentLevel[];
}

/** Something that was not written because pictures hardly need it, with the two numbers that decided. */
export interface LeftOut {
  what: string;
  count: number;
  error: number;
  bytes: number;
}

/** A ball of positions that a scene may be looked at from, and where a viewer there looks. */
export interface Place {
  position: number[];
  focus: number[];
  up: number[];
  reach: number;
}

/** A unit: one key tier of one tile of one group. */
export interface GroupTier {
  count: number;
  kept: number;
  sidecar: FileEntry;
  qualities: Atlas[];
  pictures: FileEntry[];
}

/** How one group's rows lie in the pictures of a key quality or a level. */
export interface Atlas {
  rows: number;
  centres: number[];
  planes: number[];
  plane_width: number;
  columns: number;
  width: number;
  height: number;
  max_error: number[];
}

/** One level of one segment. */
export interface SegmentLevel {
  files: FileEntry[];
  frame_bytes: number[][];
  psnr: number[];
  worst: number[];
  ssim: number[];
  delta_e: number[];
}

// What no single field of the tables can tell: counts, spans, and fields that refer to each other. Each check relies on
// those before it, and all on the schema. Every function throws FormatError (bad_value, missing_entry).
import {
  BLOCK,
  DELTA_AT,
  DELTA_ATTRIBUTES,
  DIGEST,
  KEYFRAME_AT,
  KEYFRAME_ATTRIBUTES,
  LIMITS,
  MAX_POSTER_BYTES,
  MIN_PICTURE_SIDE,
  PAGE,
  ROOT_PATH,
} from "../generated/constants.ts";
import { pages, planeHeight } from "./atlas.ts";
import { FormatError } from "./errors.ts";
import { type Entry, sum } from "./index.ts";
import { groupPath } from "./paths.ts";
import { isSimilarity } from "./region.ts";
import { packetsOf } from "./sound.ts";
import { colourChannels, gridUnit } from "./steps.ts";
import type { Atlas, FileEntry, Group, Page, Region, Root, Segment } from "./types.ts";

const bad = (where: string, detail: string) => new FormatError("bad_value", where, detail);

class Place {
  constructor(readonly where: string) {}

  within(name: string, value: number, low: number, high: number): void {
    if (!(value >= low && value <= high))
      throw bad(`${this.where}.${name}`, `expected ${low} to ${high}, got ${value}`);
  }

  exactly(name: string, value: number, expected: number): void {
    if (value !== expected) throw bad(`${this.where}.${name}`, `expected ${expected}, got ${value}`);
  }

  /** A file is there where one is wanted, and only there; a length and a digest come together. */
  file(name: string, entry: FileEntry, wanted: boolean): void {
    const where = `${this.where}.${name}`;
    if (!wanted && entry.bytes) throw bad(where, "expected no file: nothing is to be fetched");
    if (wanted && !entry.bytes) throw new FormatError("missing_entry", where, "expected a file");
    if (!entry.bytes !== !entry.sha256) {
      throw bad(where, `expected both a length and a digest or neither, got ${entry.bytes} and "${entry.sha256}"`);
    }
  }

  columns(name: string, { frames, segments, bytes, sha256 }: Page): void {
    const lengths = [frames.length, segments.length, bytes.length, sha256.length / DIGEST];
    if (new Set(lengths).size > 1) throw bad(`${this.where}${name}`, `expected columns of one length, got ${lengths}`);
  }
}

export function checkRoot(root: Root): void {
  const place = new Place(ROOT_PATH);
  const ids = [...root.qualities, ...root.levels].map((one) => one.id).join();
  const expected = [...root.qualities.map((_, q) => `Q${q}`), ...root.levels.map((_, j) => `L${j}`)].join();
  if (ids !== expected) throw bad(`${ROOT_PATH}.levels`, `expected ${expected}, got ${ids}`);
  checkLadder(root, place);
  checkRegion(root.region, `${ROOT_PATH}.region`);
  if (root.world && !isSimilarity(root.world)) {
    throw bad(`${ROOT_PATH}.world.transform`, `expected a similarity, got ${root.world.transform}`);
  }
  if ((BigInt(root.timescale) * BigInt(root.frame_rate[1]!)) % BigInt(root.frame_rate[0]!)) {
    throw bad(`${ROOT_PATH}.timescale`, "a frame is not a whole number of ticks");
  }
  place.file("init", root.init, true);
  if (root.poster) {
    place.file("poster", root.poster, true);
    place.within("poster.bytes", root.poster.bytes, 1, MAX_POSTER_BYTES);
  }
  if (root.sound) place.file("sound.init", root.sound.init, true);
  place.exactly("rungs", root.rungs.length, qualitiesMeasured(root));
  root.rungs.forEach((levels, q) => {
    place.exactly(`rungs[${q}]`, levels.length, root.levels.length);
  });
  checkIndex(root, place);
}

/** Checks the entries that fill no page, level by level, with no empty level at the end; the groups have all frames. */
function checkIndex({ index, frames }: Root, place: Place): void {
  index.forEach((spans, level) => {
    place.columns(`.index[${level}]`, spans);
    place.within(`index[${level}]`, spans.frames.length, 0, PAGE - 1);
    for (const count of [...spans.frames, ...spans.segments]) {
      place.within(`index[${level}] frames and segments`, count, PAGE ** level, frames);
    }
  });
  place.within("entries of the last level of the index", index.at(-1)!.frames.length, 1, PAGE - 1);
  place.exactly("index", sum(index.map((spans) => sum(spans.frames))), frames);
}

function checkLadder({ qualities, levels, tiers }: Root, place: Place): void {
  qualities.forEach(({ coarser }, q) => {
    place.within(`qualities[${q}].coarser`, coarser, q ? qualities[q - 1]!.coarser : 0, q ? LIMITS.bits : 0);
  });
  levels.forEach((level, j) => {
    const before = levels[j - 1];
    place.within(`levels[${j}].tiers`, level.tiers, before ? 1 : tiers, before?.tiers ?? tiers);
    place.within(`levels[${j}].quality`, level.quality, before?.quality ?? 0, qualities.length - 1);
  });
}

/** Every place of a region has a direction to look in and one that is up. */
function checkRegion(region: Region, where: string): void {
  for (const [p, { position, focus, up }] of region.places.entries()) {
    const equal = (one: number[], other: number[]) => one.every((value, axis) => value === other[axis]);
    if (equal(focus, position)) throw bad(`${where}.places[${p}].focus`, `expected other than ${position}`);
    if (equal(up, [0, 0, 0])) throw bad(`${where}.places[${p}].up`, "expected other than 0, 0, 0");
  }
}

export function checkPage(entry: Entry, page: Page, where: string): void {
  const place = new Place(where);
  place.columns("", page);
  place.exactly("entries", page.frames.length, PAGE);
  place.exactly("frames", sum(page.frames), entry.stop - entry.start);
  place.exactly("segments", sum(page.segments), entry.segments);
}

/** Checks that the table of a group, counted from 0, fits the package, the index and itself. */
export function checkGroup(root: Root, entry: Entry, group: Group, number: number): void {
  const where = groupPath(number + 1);
  const place = new Place(where);
  if (group.base) place.within("base", group.base, 1, number);
  place.exactly("start", group.start, entry.start);
  place.exactly("stop", group.stop, entry.stop);
  place.exactly("segments", group.segments.length, entry.segments);
  checkShapes(root, group, place);
  checkCounts(root, group, place);
  checkAtlases(root, group, place);
  if (!group.sound !== !root.sound) {
    throw bad(`${where}.sound`, "expected an entry where, and only where, airgs.json has sound");
  }
  const packets = packetsOf(root, group);
  if (group.sound) place.file("sound", group.sound, packets.start < packets.stop);
  for (const [t, tier] of group.tiers.entries()) {
    place.file(`tiers[${t}].sidecar`, tier.sidecar, tier.count > 0);
    for (const [q, picture] of tier.pictures.entries())
      place.file(`tiers[${t}].pictures[${q}]`, picture, tier.qualities[q]!.rows > 0);
  }
  let stop = group.start;
  group.segments.forEach((segment, s) => {
    const here = new Place(`${where}.segments[${s}]`);
    here.exactly("start", segment.start, stop);
    here.within("stop", segment.stop, stop + 1, group.stop);
    stop = segment.stop;
    checkSegment(root, group, segment, here);
  });
  place.exactly("stop of the segments", stop, group.stop);
}

/** Checks that `base`, the group whose rows a group keeps, keeps none and is laid out alike. */
export function checkBase(group: Group, base: Group, where: string): void {
  if (!base.base && laidOut(group) === laidOut(base)) return;
  throw bad(`${where}.base`, `expected a base laid out alike, got ${group.base}`);
}

const laidOut = (group: Group) =>
  JSON.stringify(group, [
    ...["grid", "origin", "step", "finest", "keyframe_steps", ...KEYFRAME_ATTRIBUTES, "sh_dc", "sh_rest"],
    ...["colour_transform", "tiers", "count", "factor"],
  ]);

function checkShapes(root: Root, group: Group, place: Place): void {
  place.exactly("tiers", group.tiers.length, root.tiers);
  place.exactly("levels", group.levels.length, root.levels.length);
  group.tiers.forEach((tier, t) => {
    place.exactly(`tiers[${t}].qualities`, tier.qualities.length, root.qualities.length);
    place.exactly(`tiers[${t}].pictures`, tier.pictures.length, root.qualities.length);
  });
  group.segments.forEach((segment, s) => {
    place.exactly(`segments[${s}].levels`, segment.levels.length, root.levels.length);
  });
}

function checkCounts(root: Root, group: Group, place: Place): void {
  const counts = group.tiers.map(({ count }) => count);
  const fewest = root.levels.at(-1)!.tiers;
  place.within("static", group.static, 0, group.count);
  place.exactly("sum of tier counts", sum(counts), group.count);
  place.within(`rows of the first ${fewest} tiers`, sum(counts.slice(0, fewest)), 1, group.count);
}

function checkAtlases(root: Root, group: Group, place: Place): void {
  const colours = colourChannels(root.sh_degree);
  place.within("grid.step", gridUnit(group), 1e-30, 1e30);
  const [first, attributes] = group.base
    ? [DELTA_AT.colour, DELTA_ATTRIBUTES]
    : [KEYFRAME_AT.colour, KEYFRAME_ATTRIBUTES];
  for (const [t, tier] of group.tiers.entries()) {
    for (const [q, atlas] of tier.qualities.entries()) {
      const at = `tiers[${t}].qualities[${q}]`;
      if (!group.base || atlas.rows) place.exactly(`${at}.rows`, atlas.rows, tier.count);
      if (atlas.rows) place.within(`planes of ${at}`, atlas.planes.length, 1, atlas.centres.length);
      checkAtlas(new Place(`${place.where}.${at}`), atlas, first + colours, attributes.length);
    }
  }
  group.levels.forEach((atlas, j) => {
    place.within(`levels[${j}].rows`, atlas.rows, 0, group.count - group.static);
    checkAtlas(new Place(`${place.where}.levels[${j}]`), atlas, DELTA_AT.colour + colours, DELTA_ATTRIBUTES.length);
  });
}

function checkAtlas(place: Place, atlas: Atlas, channels: number, attributes: number): void {
  const { centres, max_error, planes, plane_width, columns, width, height } = atlas;
  place.exactly("centres", centres.length, channels);
  place.exactly("max_error", max_error.length, attributes);
  planes.forEach((plane, i) => {
    place.within(`planes[${i}]`, plane, i ? planes[i - 1]! + 1 : 0, channels - 1);
  });
  if (!planes.length) return;
  place.within("plane_width", plane_width, BLOCK, LIMITS.side);
  place.exactly(`plane_width % ${BLOCK}`, plane_width % BLOCK, 0);
  place.within("columns", columns, 1, planes.length);
  place.within("height", height, BLOCK, LIMITS.side);
  place.exactly(`width % ${BLOCK}`, width % BLOCK, 0);
  place.within("width", width, BLOCK, Math.max(MIN_PICTURE_SIDE, plane_width * columns));
  place.exactly(`height % ${BLOCK}`, height % BLOCK, 0);
  place.within("macroblocks", (width * height) / BLOCK ** 2, 1, LIMITS.macroblocks);
  place.within("width of the planes", plane_width * columns, BLOCK, width);
  place.within("height of a plane", planeHeight(atlas.rows, plane_width), 0, LIMITS.pages * LIMITS.side);
  place.within("pages", pages(atlas), 1, LIMITS.pages);
}

const qualitiesMeasured = ({ views, qualities }: Root) => (views.reference === "none" ? 0 : qualities.length);

function checkSegment(root: Root, group: Group, segment: Segment, place: Place): void {
  const measured = qualitiesMeasured(root);
  segment.levels.forEach((level, j) => {
    place.exactly(`levels[${j}].psnr`, level.psnr.length, measured);
    place.exactly(`levels[${j}].delta_e`, level.delta_e.length, measured);
    const { file, frame_bytes } = level;
    const fetched = file.bytes > 0;
    place.file(`levels[${j}].file`, file, fetched && group.levels[j]!.planes.length > 0);
    const frames = fetched ? segment.stop - segment.start : 0;
    if (level.slopes) place.within(`levels[${j}].slopes`, frames, 2, Infinity);
    place.exactly(`levels[${j}].frame_bytes`, frame_bytes.length, frames);
    if (sum(frame_bytes) <= file.bytes) return;
    const detail = `frame_bytes add up to ${sum(frame_bytes)}, the file has ${file.bytes}`;
    throw new FormatError("size_mismatch", `${place.where}.levels[${j}]`, detail);
  });
}

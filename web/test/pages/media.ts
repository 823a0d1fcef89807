// What the media part does in a browser, task by task: /plan.json lists them, `window.report` is what came of each.

import { openFrames } from "../../src/airgs-frames.ts";
import { atlasSamples, basesAfter } from "../../src/format/atlas.ts";
import { FormatError } from "../../src/format/errors.ts";
import { readDeltas } from "../../src/format/files.ts";
import { canonicalGaussians, shownGaussians } from "../../src/format/gaussians.ts";
import { groupPath } from "../../src/format/paths.ts";
import type { Atlas, BaseChanges, Canonical, CanonicalName, DeltaFrame, Gaussians } from "../../src/format/types.ts";
import { type Fetched, Media } from "../../src/media/client.ts";
import { PictureDecoder } from "../../src/media/pictures.ts";
import { probeBrowser } from "../../src/media/probe.ts";
import { decodes } from "./decoders.ts";
import { probes } from "./mocks.ts";

interface Step {
  name: string;
  task: string;
  /** Of the package. */
  url: string;
  [argument: string]: unknown;
}

/** Throws why a file could not be had. */
function demand(fetched: Fetched): Fetched {
  for (const error of fetched.refused.values()) throw error;
  return fetched;
}

async function openGroup(media: Media, group: number): Promise<void> {
  for (const path of media.tables.index.pagesTo("groups", group)) demand(await media.fetch([path], { attempts: 1 }));
  demand(await media.fetch([groupPath(group + 1)], { attempts: 1 }));
  const { base } = media.tables.group(group);
  if (base && !media.tables.has(base - 1)) await openGroup(media, base - 1);
}

/** SHA-256 of the pages of a picture, each in hexadecimal. */
async function digests(luma: Uint8Array, atlas: Atlas): Promise<string[]> {
  const size = atlas.width * atlas.height;
  const found: string[] = [];
  for (let at = 0; at < luma.length; at += size) {
    const hash = await crypto.subtle.digest("SHA-256", luma.slice(at, at + size));
    found.push([...new Uint8Array(hash)].map((byte) => byte.toString(16).padStart(2, "0")).join(""));
  }
  return found;
}

/** A canonical space, whose keyframe files it fetches. */
async function canonicalOf(media: Media, of: CanonicalName) {
  demand(await media.fetch(media.tables.keyframesOf(of.group, of.quality, of.tiers), { attempts: 1 }));
  return media.canonical(of);
}

async function framesOf(media: Media, segment: number, level: number, of: CanonicalName) {
  const frames: (DeltaFrame | null)[] = [];
  demand(await media.fetch(media.tables.deltaFiles(segment, level), { attempts: 1 }));
  const count = await media.segment(segment, level, of, (t, frame) => {
    if (t !== frames.length) throw new Error(`expected frame ${frames.length}, got ${t}`);
    frames.push(frame);
    media.taken(frame);
  });
  if (count !== frames.length) throw new Error(`expected ${count} frames, got ${frames.length}`);
  return frames;
}

/** Digests of the luma of every picture of a package, by file: all pictures of its first page, then all of the next. */
async function luma({ url }: Step): Promise<unknown> {
  const media = await Media.open(url, { attempts: 1 });
  const { root, index } = media.tables;
  const found: Record<string, string[]> = {};
  for (let group = 0; group < index.groups; group++) {
    await openGroup(media, group);
    const of = { group, quality: 0, tiers: root.tiers };
    for (let quality = 0; quality < root.qualities.length; quality++) {
      const canonical = await canonicalOf(media, { ...of, quality });
      const base = media.tables.base(group) !== null;
      const own = canonical.parts.flatMap((part) => (base ? (part.difference ?? []) : part));
      const tiers = Array.from({ length: root.tiers }, (_, tier) => media.tables.keyframeFiles(group, tier, quality));
      const pictures = tiers.flat().filter((path) => path.endsWith(".m4s"));
      for (const [i, part] of own.entries()) found[pictures[i]] = await digests(part.luma, part.atlas);
    }
    const { start, stop } = media.tables.segmentsOf(group);
    for (let segment = start; segment < stop; segment++) {
      for (const [level, atlas] of media.tables.group(group).levels.entries()) {
        const frames = await framesOf(media, segment, level, of);
        const parts = await Promise.all(frames.map((frame) => (frame ? digests(frame.luma, atlas) : [])));
        const [path] = media.tables.deltaFiles(segment, level);
        if (path) found[path] = parts[0].flatMap((_, page) => parts.map((pages) => pages[page]));
      }
    }
  }
  media.close();
  return { luma: media.luma, found };
}

const NAMES = ["means", "quaternions", "logScales", "alpha", "colours"] as const;

/** How far frames are from /expected files: of each attribute, the largest error, and the largest one of the sort's means. */
async function frames(step: Step): Promise<unknown> {
  const { url, quality, level, tiers, expected } = step as Step & {
    quality: number;
    level: number;
    tiers: number;
    expected: string;
  };
  const media = await Media.open(url);
  const worst = { means: 0, quaternions: 0, logScales: 0, alpha: 0, colours: 0, sorted: 0 };
  let frame = 0;
  for (let group = 0; group < media.tables.index.groups; group++) {
    await openGroup(media, group);
    const canonical = await canonicalOf(media, { group, quality, tiers });
    const { start, stop } = media.tables.segmentsOf(group);
    for (let segment = start; segment < stop; segment++) {
      for (const { gaussians, sorted } of await shownOf(media, segment, level, canonical)) {
        const data = await (await fetch(`${expected}/${frame++}`)).arrayBuffer();
        compare(gaussians, new Float32Array(data), worst, sorted);
      }
    }
  }
  media.close();
  return { worst, frames: frame };
}

/** Every frame of a segment, and the means that it is sorted by. */
async function shownOf(media: Media, segment: number, level: number, canonical: Canonical) {
  const { root } = media.tables;
  const table = media.tables.group(canonical.group);
  const base = canonicalGaussians(root, table, canonical);
  const samples = atlasSamples(table.levels[level]);
  const changes: (BaseChanges | null)[] = [];
  return (await framesOf(media, segment, level, canonical)).map((shown) => {
    changes.push(shown?.bases ?? null);
    const slopes = changes[0]?.slopes ?? null;
    const delta = shown && { ...shown, level, slopes, bases: basesAfter(samples, changes) };
    const gaussians = shownGaussians(root, table, base, canonical, delta);
    return { gaussians, sorted: shown?.means ?? canonical.means };
  });
}

function compare(got: Gaussians, expected: Float32Array, worst: Record<string, number>, sorted: Float32Array): void {
  let at = 0;
  for (const name of NAMES) {
    for (const value of got[name]) {
      const truth = expected[at++];
      worst[name] = Math.max(worst[name], Math.abs(value - truth) / Math.max(1, Math.abs(truth)));
    }
  }
  if (at !== expected.length) throw new Error(`expected ${expected.length} numbers, got ${at}`);
  sorted.forEach((mean, i) => {
    worst.sorted = Math.max(worst.sorted, Math.abs(mean - expected[i]));
  });
}

/** How far frames that are read in any order are from /expected files: of each attribute, the largest error. */
async function reading(step: Step): Promise<unknown> {
  const { url, rung, frames, expected } = step as Step & { rung: string; frames: number[]; expected: string };
  const reader = await openFrames(url);
  const worst = { means: 0, quaternions: 0, logScales: 0, alpha: 0, colours: 0, sorted: 0 };
  for (const frame of frames) {
    const got = await reader.gaussians(frame, rung);
    const data = await (await fetch(`${expected}/${frame}`)).arrayBuffer();
    compare(got, new Float32Array(data), worst, got.means);
  }
  reader.close();
  return worst;
}

/** What a fetch of some paths came to, a step of the page's own clock later. */
async function fetching(step: Step): Promise<unknown> {
  const {
    url,
    paths,
    times = 1,
    abortMs,
    attempts = 4,
  } = step as Step & { paths: string[]; times?: number; abortMs?: number; attempts?: number };
  const media = await Media.open(url);
  const came: unknown[] = [];
  for (let time = 0; time < times; time++) {
    const progress: number[] = [];
    let expected = 0;
    const before = performance.now() / 1e3;
    const signal = abortMs === undefined ? undefined : AbortSignal.timeout(abortMs);
    const onProgress = (bytes: number, all: number) => {
      progress.push(bytes);
      expected = all;
    };
    const got = await media.fetch(paths, { signal, attempts, onProgress });
    const inOrder = before <= got.firstByteS && got.firstByteS <= got.endS && got.endS <= performance.now() / 1e3;
    const refused = Object.fromEntries([...got.refused].map(([path, { reason, detail }]) => [path, [reason, detail]]));
    came.push({ ...got, refused, inOrder, progress, expected });
  }
  const groups = Array.from({ length: media.tables.index.groups }, (_, group) => media.tables.has(group));
  media.close();
  return { came, groups, opened: media.opened };
}

/** Reads airgs.json of a growing package until it is closed. */
async function growing({ url }: Step): Promise<unknown> {
  const media = await Media.open(url);
  const seen: [number, boolean][] = [[media.tables.index.groups, media.tables.root.live]];
  while (media.tables.root.live) {
    demand(await media.refreshRoot());
    seen.push([media.tables.index.groups, media.tables.root.live]);
  }
  const last = media.tables.index.groups - 1;
  await openGroup(media, last);
  const start = media.tables.group(last).start;
  media.close();
  return { seen, start };
}

/** How far decoding goes while the page takes nothing, then one frame, then the rest; and after giving up. */
async function ahead({ url }: Step): Promise<unknown> {
  const media = await Media.open(url, { aheadBytes: 1 });
  await openGroup(media, 0);
  const of = { group: 0, quality: 0, tiers: media.tables.root.tiers };
  await canonicalOf(media, of);
  const [path] = media.tables.deltaFiles(0, 0);
  demand(await media.fetch([path]));
  const frames: (DeltaFrame | null)[] = [];
  const waiting = media.segment(0, 0, of, (_, frame) => frames.push(frame));
  const settled = async () => {
    for (let before = -1; before !== frames.length; ) {
      before = frames.length;
      await new Promise((resolve) => setTimeout(resolve, 150));
    }
    return frames.length;
  };
  const counts = [await settled()];
  for (let t = 0; t < frames.length; t++) {
    media.taken(frames[t]);
    if (t === frames.length - 1) counts.push(await settled());
  }
  const total = await waiting;
  demand(await media.fetch([path]));
  const stop = new AbortController();
  const given = media.segment(0, 0, of, () => stop.abort(), stop.signal);
  const error = await given.catch((problem: Error) => problem.name);
  demand(await media.fetch([path]));
  const again = await media.segment(0, 0, of, (_, frame) => media.taken(frame));
  media.close();
  return { counts, total, error, again };
}

/** What comes of files that no table leads to, that were not fetched, and of a worker that was closed. */
async function mistakes({ url }: Step): Promise<unknown> {
  const media = await Media.open(url);
  const said: unknown[] = [];
  const say = (error: unknown) => said.push(describe(error));
  const early = await media.fetch(["keyframe/T0/1.bin", "nothing/1.bin"]);
  for (const error of early.refused.values()) say(error);
  await openGroup(media, 0);
  const of = { group: 0, quality: 0, tiers: 1 };
  said.push((await media.canonical(of)).depths.length);
  const late = media.canonical(of).catch(say);
  media.close();
  await late;
  await media.canonical(of).catch(say);
  return said;
}

/** Opening alone. */
async function opening({ url }: Step): Promise<unknown> {
  const media = await Media.open(url, { attempts: 1 });
  media.close();
  return { groups: media.tables.index.groups, bytes: media.opened.bytes };
}

/** What the player's decoder makes of delta files in which one bit of a coded picture is flipped: no digest is looked at. */
async function flips(step: Step): Promise<unknown> {
  const { url, level, seed, count, seconds } = step as Step & Record<"level" | "seed" | "count" | "seconds", number>;
  const media = await Media.open(url);
  await openGroup(media, 0);
  const [path] = media.tables.deltaFiles(0, level);
  const bytes = new Uint8Array(await (await fetch(new URL(path, new URL(url, location.href)))).arrayBuffer());
  const read = () => readDeltas(media.tables.group(0), { segment: 0, place: 0, level }, bytes.slice());
  const decoder = new PictureDecoder(await probeBrowser());
  const decode = async (deltas: ReturnType<typeof read>) => {
    const pictures: Uint8Array[] = [];
    await decoder.decode({ ...deltas, where: path }, (t, luma) => (pictures[t] = luma));
    return pictures;
  };
  const right = await decode(read());
  const came = { tried: 0, refused: 0, same: 0, other: 0, unlike: [] as string[] };
  const end = performance.now() + 1e3 * seconds;
  let delta = seed;
  const chance = (below: number) => {
    delta = (Math.imul(delta, 1664525) + 1013904223) >>> 0; // Numerical Recipes' generator
    return Math.floor((delta / 2 ** 32) * below);
  };
  while (came.tried < count && performance.now() < end) {
    const deltas = read();
    const samples = deltas.pages.flat();
    const { data } = samples[chance(samples.length)];
    data[chance(data.length)] ^= 1 << chance(8);
    came.tried++;
    const got = await decode(deltas).catch((error: Error) => error);
    if (got instanceof Error) {
      came.refused++;
      if (!(got instanceof FormatError && got.reason === "bad_picture")) came.unlike.push(String(got));
    } else if (got.every((luma, i) => luma.every((value, k) => value === right[i][k]))) came.same++;
    else came.other++;
  }
  media.close();
  return came;
}

function describe(error: unknown): unknown {
  if (error instanceof FormatError)
    return { name: error.name, reason: error.reason, where: error.where, detail: error.detail };
  const { name, message, stack } = error as Error;
  return { name, message, stack };
}

const tasks: Record<string, (step: Step) => Promise<unknown>> = {
  luma,
  frames,
  reading,
  fetching,
  growing,
  ahead,
  mistakes,
  opening,
  flips,
  ...probes,
  ...decodes,
};

async function run(): Promise<Record<string, unknown>> {
  const plan: Step[] = await (await fetch("/plan.json")).json();
  const report: Record<string, unknown> = {};
  for (const step of plan) {
    report[step.name] = await tasks[step.task](step).catch((error) => ({ error: describe(error) }));
  }
  return report;
}

Object.assign(window, { report: run() });

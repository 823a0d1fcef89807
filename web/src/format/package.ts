// The tables of a package as one value, which grows as they are read: FORMAT.md, section 2. Groups, segments, keyframe tiers,
// qualities, levels and pages count from 0; groups, segments and pages in paths from 1.
import { INIT_PATH, PAGE, POSTER_PATH, ROOT_PATH, SOUND_INIT_PATH } from "../generated/constants.ts";
import { group as groupSchema, page as pageSchema } from "../generated/schema.ts";
import { Recent } from "./collections.ts";
import { FormatError } from "./errors.ts";
import { countPages, GroupIndex, MissingTableError } from "./index.ts";
import { inflate, parseRoot, parseTable } from "./parse.ts";
import {
  deltaMediaPath,
  groupPath,
  isPacked,
  keyframeMediaPath,
  keyframeSidecarPath,
  locate,
  pagePath,
  soundPath,
} from "./paths.ts";
import { checkBase, checkGroup, checkPage } from "./references.ts";
import type { FileEntry, Group, Page, Root, Segment } from "./types.ts";

const MOST_TABLES = 1024; // tables of groups
const BRACE = 0x7b; // begins JSON
const GROWS = new Set(["frames", "index", "decisions", "rungs", "live"]);

export class Tables {
  #groups = new Recent<number, Group>(MOST_TABLES);
  #starts = new Map<string, Page>();

  private constructor(
    public root: Root,
    public index: GroupIndex,
    public rootBytes: number,
  ) {}

  static parse(rootBytes: Uint8Array): Tables {
    const root = parseRoot(rootBytes);
    return new Tables(root, new GroupIndex(root.index), rootBytes.length);
  }

  /** Throws FormatError (size_mismatch, hash_mismatch) unless a file is what its entry says. */
  static async check(path: string, entry: FileEntry, bytes: Uint8Array): Promise<void> {
    if (bytes.length !== entry.bytes) {
      throw new FormatError("size_mismatch", path, `expected ${entry.bytes} bytes, got ${bytes.length}`);
    }
    if ((await digest(bytes)) !== entry.sha256) {
      throw new FormatError("hash_mismatch", path, "the SHA-256 differs from the one in the tables");
    }
  }

  /** Takes in the bytes of a page, whose digest was checked. Throws FormatError; MissingTableError. */
  addPage(path: string, bytes: Uint8Array): void {
    const page = parseTable(bytes, pageSchema, path) as Page;
    checkPage(this.index.pageEntry(path), page, path);
    const start = this.#starts.get(path);
    if (start) expectStart(page, start, path);
    this.index.addPage(path, page);
    this.#starts.delete(path); // from now on the levels above say what it is
  }

  /** Takes in the bytes of a group's table, whose digest was checked. Throws FormatError; MissingTableError. */
  async addGroup(number: number, bytes: Uint8Array, unpacked = false): Promise<Group> {
    const where = groupPath(number + 1);
    const entry = this.index.entry(number);
    const text = unpacked ? bytes : await inflate(bytes, where);
    const table = parseTable(text, groupSchema, where) as Group;
    checkGroup(this.root, entry, table, number);
    const others = new Map(this.#groups.entries()).set(number, table);
    for (const [n, one] of others) {
      const base = others.get((one.base ?? 0) - 1);
      if (base && (one === table || base === table)) checkBase(one, base, groupPath(n + 1));
    }
    return this.#groups.set(number, table);
  }

  /** Takes in a page or the table of a group and checks its digest, unless a server had it unpacked; no other path. */
  async add(path: string, bytes: Uint8Array): Promise<void> {
    const found = locate(path);
    if (found?.what !== "page" && found?.what !== "group") return;
    const entry = this.entry(path);
    const unpacked = isPacked(path) && bytes[0] === BRACE && bytes.length !== entry.bytes;
    if (!unpacked) await Tables.check(path, entry, bytes);
    if (found.what === "page") this.addPage(path, bytes);
    else await this.addGroup(found.numbers[0]! - 1, bytes, unpacked);
  }

  has(number: number): boolean {
    return this.#groups.has(number);
  }

  /** The table of a group. Throws MissingTableError for it, or for a page that has yet to say where it is. */
  group(number: number): Group {
    const found = this.#groups.get(number);
    if (found) return found;
    this.index.entry(number);
    throw new MissingTableError(groupPath(number + 1));
  }

  groupOf(segment: number): number {
    return this.index.groupAt("segments", segment);
  }

  rows(group: number): number[] {
    return this.group(group).tiers.map(({ count }) => count);
  }

  segment(segment: number): Segment {
    const group = this.groupOf(segment);
    return this.group(group).segments[segment - this.index.entry(group).firstSegment]!;
  }

  segmentsOf(group: number): { start: number; stop: number } {
    const { firstSegment, segments } = this.index.entry(group);
    return { start: firstSegment, stop: firstSegment + segments };
  }

  segmentAt(frame: number): number {
    const group = this.index.groupAt("frames", frame);
    const { segments } = this.group(group);
    return this.index.entry(group).firstSegment + segments.findIndex((segment) => frame < segment.stop);
  }

  /** The base of a group, whose rows it keeps; null: it has none. Throws what `group` does. */
  base(group: number): number | null {
    const { base } = this.group(group);
    return base ? base - 1 : null;
  }

  /** Sidecar and picture of a keyframe tier: none of one without rows, no picture where nothing differs from the base. */
  keyframeFiles(group: number, tier: number, quality: number): string[] {
    const { count, qualities } = this.group(group).tiers[tier]!;
    const files = [keyframeSidecarPath(tier, group + 1), keyframeMediaPath(tier, quality, group + 1)];
    return files.slice(0, Number(count > 0) + Number(qualities[quality]!.rows > 0));
  }

  keyframesOf(group: number, quality: number, tiers: number): string[] {
    const groups = [group, this.base(group) ?? []].flat();
    const all = Array.from({ length: tiers }, (_, tier) =>
      groups.flatMap((of) => this.keyframeFiles(of, tier, quality)),
    );
    return all.flat();
  }

  deltaFiles(segment: number, level: number): string[] {
    return this.segment(segment).levels[level]!.file.bytes ? [deltaMediaPath(level, segment + 1)] : [];
  }

  soundFiles(group: number): string[] {
    return this.group(group).sound?.bytes ? [soundPath(group + 1)] : [];
  }

  /** Length and digest of a file. Throws FormatError(missing_entry); MissingTableError. */
  entry(path: string): FileEntry {
    const shared: Record<string, FileEntry | undefined> = {
      [INIT_PATH]: this.root.init,
      [POSTER_PATH]: this.root.poster,
      [SOUND_INIT_PATH]: this.root.sound?.init,
    };
    const found = shared[path] ?? this.#find(path);
    if (!found?.bytes) throw new FormatError("missing_entry", path, "no table has such a file");
    return found;
  }

  #find(path: string): FileEntry | null | undefined {
    const found = locate(path);
    if (!found) return null;
    const { what, numbers } = found;
    const [first = 0, second = 0] = numbers;
    const number = numbers.at(-1)! - 1;
    const { segments, groups } = this.index;
    if (what === "page") return (number + 1) * PAGE ** first > groups ? null : this.index.pageEntry(path).file;
    if (number >= (what === "delta" ? segments : groups)) return null;
    if (what === "group") return this.index.entry(number).file;
    if (what === "sound") return this.group(number).sound;
    if (what === "delta") return this.segment(number).levels[first]?.file;
    const tier = this.group(number).tiers[first];
    return what === "sidecar" ? tier?.sidecar : tier?.pictures[second];
  }

  /** Goes on with the airgs.json of the same package grown. Throws FormatError(bad_value) for another package. */
  grow(rootBytes: Uint8Array): void {
    const root = parseRoot(rootBytes);
    for (const [path, start] of checkGrowth(this.root, root)) this.#starts.set(path, start);
    this.root = root;
    this.rootBytes = rootBytes.length;
    this.index = this.index.grown(root.index);
  }
}

const NO_SPANS: Page = { frames: [], segments: [], bytes: [], sha256: "" };
const ANOTHER = "expected the package of before with more groups, got another";

/** Throws FormatError(bad_value) unless columns begin as they were before. */
function expectStart(columns: Page, start: Page, where: string): void {
  const begins = (name: "frames" | "segments" | "bytes") => start[name].every((count, i) => count === columns[name][i]);
  const same = begins("frames") && begins("segments") && begins("bytes") && columns.sha256.startsWith(start.sha256);
  if (!same) throw new FormatError("bad_value", where, ANOTHER);
}

const inOrder = (value: object) =>
  JSON.stringify(value, (_, part: unknown) =>
    part && typeof part === "object" && !Array.isArray(part) ? Object.fromEntries(Object.entries(part).sort()) : part,
  );

/** What pages filled since must begin with. Throws FormatError(bad_value) unless a root can follow. */
function checkGrowth(before: Root, after: Root): [string, Page][] {
  const fixed = (root: Root) => inOrder(Object.fromEntries(Object.entries(root).filter(([name]) => !GROWS.has(name))));
  if (fixed(before) !== fixed(after) || after.frames < before.frames || (after.live && !before.live)) {
    throw new FormatError("bad_value", ROOT_PATH, ANOTHER);
  }
  return before.index.flatMap((spans, level) => {
    const page = countPages(before.index, level + 1);
    if (page !== countPages(after.index, level + 1)) return [[pagePath(level + 1, page + 1), spans]];
    expectStart(after.index[level] ?? NO_SPANS, spans, ROOT_PATH);
    return [];
  });
}

/** The first 24 bytes of the SHA-256 of a file as 32 characters of base64url. */
async function digest(bytes: Uint8Array): Promise<string> {
  const hash = await crypto.subtle.digest("SHA-256", bytes as Uint8Array<ArrayBuffer>);
  const text = btoa(String.fromCharCode(...new Uint8Array(hash, 0, 24)));
  return text.replaceAll("+", "-").replaceAll("/", "_");
}

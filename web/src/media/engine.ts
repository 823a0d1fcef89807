// Everything between the network and the renderer, whatever thread it runs on: fetch, check, decode.
import { Recent } from "../format/collections.ts";
import { FormatError } from "../format/errors.ts";
import { MissingTableError } from "../format/index.ts";
import { Tables } from "../format/package.ts";
import { isPacked, isTable, locate, soundPath } from "../format/paths.ts";
import type { Canonical, CanonicalName, DeltaFrame, FileEntry } from "../format/types.ts";
import { ATTEMPTS, HEADER_BYTES, MAX_TABLE_BYTES, POSTER_PATH, ROOT_PATH } from "../generated/constants.ts";
import { type FileAsk, fetchBatch } from "./batch.ts";
import { Ahead, Bell } from "./bell.ts";
import { aborted, fromWire, toWire } from "./errors.ts";
import { checkReprDigest, FileClient } from "./http.ts";
import type { Calls, Poster, WireBatch } from "./messages.ts";
import { PictureDecoder } from "./pictures.ts";
import { type Probe, probeBrowser } from "./probe.ts";
import * as spaces from "./spaces.ts";

const MOST_SEGMENTS = 2; // of which something is decoded and not shown
const MOST_SPACES = 4; // whose positions stay for the segments over them
const MOST_TIERS = 6; // of keyframes that stay decoded, as groups over them want them again

export interface Context<Event> {
  id: number;
  signal: AbortSignal;
  emit: (event: Event) => void;
}

export class Engine {
  /** Files that were fetched, tables aside: what is played again is not fetched again. */
  readonly #kept: Recent<string, Uint8Array>;
  readonly #spaces = new Recent<string, spaces.Positions>(MOST_SPACES);
  readonly #tiers = new Recent<string, Promise<spaces.Tier | null>>(MOST_TIERS);
  /** Rings when a file has come, and when no more of a fetch will. */
  readonly #came = new Bell();
  readonly ahead: Ahead;
  readonly #keyframes: PictureDecoder;
  readonly #deltas: PictureDecoder;

  private constructor(
    private readonly client: FileClient,
    probe: Probe,
    readonly tables: Tables,
    { aheadBytes, keptBytes }: Pick<Calls["open"]["args"], "aheadBytes" | "keptBytes">,
  ) {
    this.#kept = new Recent(keptBytes, (bytes) => bytes.length);
    this.ahead = new Ahead(aheadBytes, MOST_SEGMENTS);
    this.#keyframes = new PictureDecoder(probe);
    this.#deltas = new PictureDecoder(probe);
  }

  /** Fetches airgs.json and the poster, probes the browser. Throws FormatError, TransportError, UnsupportedError. */
  static async open(
    { url, attempts, ...limits }: Calls["open"]["args"],
    { signal, emit }: Pick<Context<Poster>, "signal" | "emit">,
    onPassing?: (words: string) => void,
  ): Promise<{ engine: Engine; opened: Calls["open"]["value"] }> {
    const probing = probeBrowser();
    probing.catch(() => {}); // it is waited for below
    const client = new FileClient(url, onPassing);
    const found: Tables[] = [];
    const batch = await fetchRoot(client, attempts, false, signal, (bytes) => found.push(Tables.parse(bytes)));
    const [tables] = found;
    const poster = tables?.root.poster;
    // For long the browser is still being looked at. Where there is no poster, the package plays as well.
    if (poster) await fetchPoster(client, poster, signal, emit).catch(() => {});
    const probe = await probing;
    for (const [, error] of batch.refused) throw fromWire(error);
    if (!tables) throw aborted();
    return { engine: new Engine(client, probe, tables, limits), opened: { luma: probe.luma, batch } };
  }

  async fetch(
    { paths, attempts }: Calls["fetch"]["args"],
    { signal, emit }: Context<Calls["fetch"]["event"]>,
  ): Promise<WireBatch> {
    const came = new Map<string, Uint8Array>();
    const whole = paths.filter((path) => this.#kept.get(path));
    const refused = new Map<string, FormatError>();
    const asks: FileAsk[] = [];
    for (const path of new Set(paths.filter((path) => !whole.includes(path)))) {
      try {
        asks.push(this.#ask(path, attempts, came));
      } catch (error) {
        const unknown = error instanceof MissingTableError || error instanceof RangeError;
        if (!unknown && !(error instanceof FormatError)) throw error;
        refused.set(path, unknown ? new FormatError("missing_entry", path, error.message) : error);
      }
    }
    const expected = asks.reduce((sum, { path }) => sum + this.tables.entry(path).bytes + HEADER_BYTES, 0);
    let over = false;
    /** Reads while files come. */
    const read = async (path: string) => {
      await this.#came.until(() => over || this.#kept.has(path));
      return this.#kept.get(path) ?? Promise.reject(aborted());
    };
    for (const { what, numbers } of paths.flatMap((path) => locate(path) ?? [])) {
      const [tier, quality, number] = numbers; // as nothing is there to be shown, it is decoded at once
      if (this.ahead.idle && what === "keyframe") this.#tier({ group: number - 1, tier, quality }, read);
    }
    const batch = await fetchBatch(this.client, asks, signal, (bytes) => emit({ bytes, expected })).finally(() => {
      over = true;
      this.#came.ring();
    });
    return {
      ...batch,
      whole: [...whole, ...batch.whole],
      refused: [...refused, ...batch.refused].map(([path, error]) => [path, toWire(error)]),
      tables: [...came].filter(([path]) => isTable(path)),
    };
  }

  async refreshRoot({ attempts }: Calls["refreshRoot"]["args"], { signal }: Context<never>): Promise<WireBatch> {
    return fetchRoot(this.client, attempts, true, signal, (bytes) => this.tables.grow(bytes));
  }

  async sound({ group }: Calls["sound"]["args"], { signal }: Context<never>): Promise<Uint8Array> {
    const path = soundPath(group + 1);
    return (await this.#file(path, signal)).slice();
  }

  async canonical(name: CanonicalName, { signal }: Pick<Context<never>, "signal">): Promise<Canonical> {
    const read = (path: string) => this.#file(path, new AbortController().signal); // others may wait for the same
    const found = await spaces.decodeCanonical(this.tables, name, (tier) => this.#tier(tier, read));
    if (signal.aborted) throw aborted();
    const { means, units, depths } = found;
    this.#spaces.set(nameOf(name), { means: means.slice(), units: units.slice(), depths: depths.slice() });
    return found;
  }

  #tier(name: spaces.TierName, read: spaces.ReadFile): Promise<spaces.Tier | null> {
    const key = `${name.group} ${name.quality} ${name.tier}`;
    const tier = this.#tiers.of(key, () => spaces.decodeTier(this.tables, name, read, this.#keyframes));
    tier.catch(() => this.#tiers.delete(key));
    return tier;
  }

  async segment(
    { index, level, of, first }: Calls["segment"]["args"],
    context: Context<Calls["segment"]["event"]>,
  ): Promise<number> {
    const { id, signal, emit } = context;
    await this.ahead.place(signal);
    if (signal.aborted) throw aborted();
    const { start, stop } = this.tables.segment(index);
    const [where] = this.tables.deltaFiles(index, level);
    if (!where) {
      for (let t = 0; t < stop - start; t++) emit({ t, frame: null });
      return stop - start;
    }
    const positions = this.#spaces.get(nameOf(of)) ?? (await this.canonical(of, { signal }));
    const file = { ...of, segment: index, level, positions, bytes: await this.#file(where, signal), where };
    const give = (t: number, frame: DeltaFrame) => {
      const { luma, means, bases } = frame;
      this.ahead.give(id, t, luma.length + means.byteLength + (bases?.slopes?.byteLength ?? 0));
      emit({ t, frame });
    };
    const room = () => this.ahead.room(id, signal);
    await spaces.decodeDeltas(this.tables, file, this.#deltas, give, { signal, room, first });
    return stop - start;
  }

  /** Throws FormatError, MissingTableError for a file that no table leads to. */
  #ask(path: string, attempts: number, came: Map<string, Uint8Array>): FileAsk {
    const entry = this.tables.entry(path);
    const accept = async (bytes: Uint8Array) => {
      if (isTable(path)) await this.tables.add(path, bytes);
      else await Tables.check(path, entry, bytes);
      if (!isTable(path)) this.#kept.set(path, bytes);
      came.set(path, bytes);
      this.#came.ring();
    };
    const limit = isPacked(path) ? MAX_TABLE_BYTES : entry.bytes; // a server may unpack it
    return { path, limit, attempts, patient: true, changing: false, accept };
  }

  /** A file; one that others took the place of is fetched again. Throws FormatError. */
  async #file(path: string, signal: AbortSignal): Promise<Uint8Array> {
    const kept = this.#kept.get(path);
    if (kept) return kept;
    const found = new Map<string, Uint8Array>();
    const { refused } = await fetchBatch(this.client, [this.#ask(path, ATTEMPTS, found)], signal);
    if (signal.aborted) throw aborted();
    for (const refusal of refused.values()) throw refusal;
    return found.get(path)!;
  }
}

const nameOf = ({ group, quality, tiers }: CanonicalName) => `${group} ${quality} ${tiers}`;

/** Without a poster a package plays as well: what is wrong with one is left unsaid. */
async function fetchPoster(
  client: FileClient,
  entry: FileEntry,
  signal: AbortSignal,
  emit: (event: Poster) => void,
): Promise<void> {
  const beganMs = performance.now();
  const accept = async (bytes: Uint8Array) => {
    await Tables.check(POSTER_PATH, entry, bytes);
    emit({ poster: bytes, seconds: (performance.now() - beganMs) / 1e3 });
  };
  const ask = { path: POSTER_PATH, limit: entry.bytes, attempts: 1, patient: false, changing: false, accept };
  await fetchBatch(client, [ask], signal);
}

/** Fetches airgs.json, which `take` takes in; `patient`: waits for a server that is away. */
async function fetchRoot(
  client: FileClient,
  attempts: number,
  patient: boolean,
  signal: AbortSignal,
  take: (bytes: Uint8Array) => void,
): Promise<WireBatch> {
  const tables: [string, Uint8Array][] = [];
  const accept = async (bytes: Uint8Array, headers: Headers) => {
    await checkReprDigest(ROOT_PATH, bytes, headers);
    take(bytes);
    tables.push([ROOT_PATH, bytes]);
  };
  const ask = { path: ROOT_PATH, limit: MAX_TABLE_BYTES, attempts, patient, changing: true, accept };
  const batch = await fetchBatch(client, [ask], signal);
  return { ...batch, refused: [...batch.refused].map(([path, error]) => [path, toWire(error)]), tables };
}

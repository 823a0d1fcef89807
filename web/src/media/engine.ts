// Everything between the network and the renderer, whatever thread it runs on: fetch, check, decode.
import { FormatError } from "../format/errors.ts";
import { MissingTableError } from "../format/index.ts";
import { Tables } from "../format/package.ts";
import { locate } from "../format/paths.ts";
import { Recent } from "../format/recent.ts";
import type { Canonical, StateFrame } from "../format/types.ts";
import { ATTEMPTS, MAX_ROOT_BYTES, ROOT_PATH } from "../generated/constants.ts";
import { Ahead } from "./ahead.ts";
import { ByteStore, type FileAsk, fetchBatch } from "./batch.ts";
import { aborted, fromWire, toWire } from "./errors.ts";
import { checkReprDigest, FileClient } from "./http.ts";
import type { Calls, CanonicalName, Opened, WireBatch } from "./messages.ts";
import { PictureDecoder } from "./pictures.ts";
import { type Probe, probeBrowser } from "./probe.ts";
import { decodeCanonical, type Positions, readPositions } from "./spaces.ts";
import { decodeStates } from "./states.ts";

const STORED_BYTES = 64 * 2 ** 20;
const MOST_SEGMENTS = 2; // of which something is decoded and not shown
const MOST_SPACES = 4; // of each tile, whose positions stay for the segments over them

/** What goes with a call. */
export interface Context<Event> {
  id: number;
  signal: AbortSignal;
  emit: (event: Event) => void;
}

/** An open package. */
export class Engine {
  readonly #store = new ByteStore(STORED_BYTES);
  readonly #spaces: Recent<string, Positions>;
  readonly #ahead: Ahead;
  readonly #keys: PictureDecoder;
  /** Of states: as many as were needed side by side, and those of them that nobody uses now. */
  readonly #states = new Set<PictureDecoder>();
  readonly #idle: PictureDecoder[] = [];

  private constructor(
    private readonly client: FileClient,
    private readonly probe: Probe,
    readonly tables: Tables,
    aheadBytes: number,
  ) {
    this.#ahead = new Ahead(aheadBytes, MOST_SEGMENTS);
    this.#spaces = new Recent(MOST_SPACES * tables.root.tiles);
    this.#keys = new PictureDecoder(probe);
  }

  /** Fetches airgs.json, and sees what the browser can do. Throws FormatError, TransportError, UnsupportedError. */
  static async open(
    { url, aheadBytes, attempts }: Calls["open"]["args"],
    { signal }: Pick<Context<never>, "signal">,
  ): Promise<{ engine: Engine; opened: Opened }> {
    const probing = probeBrowser();
    probing.catch(() => {}); // it is waited for below
    const client = new FileClient(url);
    const found: Tables[] = [];
    const batch = await fetchRoot(client, attempts, false, signal, (bytes) => found.push(Tables.parse(bytes)));
    const probe = await probing;
    for (const [, error] of batch.refused) throw fromWire(error);
    const [tables] = found;
    if (!tables) throw aborted();
    return { engine: new Engine(client, probe, tables, aheadBytes), opened: { luma: probe.luma, batch } };
  }

  async fetch({ paths, attempts }: Calls["fetch"]["args"], { signal, emit }: Context<number>): Promise<WireBatch> {
    const tables: [string, Uint8Array][] = [];
    const refused = new Map<string, FormatError>();
    const asks: FileAsk[] = [];
    for (const path of new Set(paths)) {
      try {
        asks.push(this.#ask(path, attempts, tables));
      } catch (error) {
        refused.set(path, asFormatError(path, error));
      }
    }
    const batch = await fetchBatch(this.client, asks, signal, emit);
    return { ...batch, refused: [...refused, ...batch.refused].map(([path, error]) => [path, toWire(error)]), tables };
  }

  /** Reads airgs.json of a growing package again. */
  async refreshRoot({ attempts }: Calls["refreshRoot"]["args"], { signal }: Context<never>): Promise<WireBatch> {
    return fetchRoot(this.client, attempts, true, signal, (bytes) => this.tables.grow(bytes));
  }

  async canonical(name: CanonicalName, { signal }: Context<never>): Promise<Canonical> {
    await this.#gather(this.#keysOf(name), signal);
    const found = await decodeCanonical(this.tables, this.#read, name, this.#keys, { signal });
    const { means, units, depths } = found;
    this.#spaces.set(nameOf(name), { means, units, depths });
    return { ...found, means: means.slice(), units: units.slice(), depths: depths.slice() };
  }

  /** A segment of a tile; those that are asked for at once are decoded side by side. */
  async segment(
    { index, level, of }: Calls["segment"]["args"],
    context: Context<Calls["segment"]["event"]>,
  ): Promise<number> {
    const { id, signal, emit } = context;
    await this.#ahead.place(index, signal);
    if (signal.aborted) throw aborted();
    const { start, stop } = this.tables.segment(index);
    const [where] = this.tables.stateFiles(index, level, [of.tile]);
    if (!where) {
      for (let t = 0; t < stop - start; t++) emit({ t, frame: null });
      return stop - start;
    }
    await this.#gather(this.#spaces.has(nameOf(of)) ? [where] : [where, ...this.#keysOf(of)], signal);
    const file = { ...of, segment: index, level, positions: this.#positions(of), bytes: this.#read(where), where };
    const give = (t: number, frame: StateFrame) => {
      this.#ahead.give(id, index, t, frame.luma.length + frame.means.byteLength);
      emit({ t, frame });
    };
    const options = { signal, room: () => this.#ahead.room(id, signal) };
    const decoder = this.#idle.pop() ?? new PictureDecoder(this.probe);
    this.#states.add(decoder);
    try {
      await decodeStates(this.tables, file, decoder, give, options);
    } finally {
      this.#idle.push(decoder);
    }
    return stop - start;
  }

  /** The page has shown a frame. */
  taken(id: number, t: number): void {
    this.#ahead.taken(id, t);
  }

  /** The page has no use for a segment any more. */
  drop(id: number): void {
    this.#ahead.drop(id);
  }

  close(): void {
    for (const decoder of [this.#keys, ...this.#states]) decoder.close();
  }

  /** Throws FormatError, MissingTableError for a file that no table leads to. */
  #ask(path: string, attempts: number, tables: [string, Uint8Array][]): FileAsk {
    const entry = this.tables.entry(path);
    const isTable = ["group", "page"].includes(locate(path)?.what ?? "");
    const accept = async (bytes: Uint8Array) => {
      if (isTable) await this.tables.add(path, bytes);
      else await Tables.check(path, entry, bytes);
      if (isTable) tables.push([path, bytes]);
      else this.#store.put(path, bytes);
    };
    return { path, limit: entry.bytes, attempts, patient: true, changing: false, accept };
  }

  #keysOf({ group, tile, quality, tiers }: CanonicalName): string[] {
    const first = tile * this.tables.root.tiers;
    const units = Array.from({ length: Math.min(tiers, this.tables.root.tiers) }, (_, tier) => first + tier);
    return this.tables.keysOf(group, quality, units);
  }

  /** Fetches files again that were fetched so long ago that others took their place. Throws FormatError. */
  async #gather(paths: string[], signal: AbortSignal): Promise<void> {
    const asks = paths.filter((path) => !this.#store.get(path)).map((path) => this.#ask(path, ATTEMPTS, []));
    if (!asks.length) return;
    const { refused } = await fetchBatch(this.client, asks, signal, () => {});
    if (signal.aborted) throw aborted();
    for (const refusal of refused.values()) throw refusal;
  }

  readonly #read = (path: string): Uint8Array => {
    const bytes = this.#store.get(path);
    if (!bytes) throw new FormatError("missing_file", path, "it has not been fetched");
    return bytes;
  };

  #positions(name: CanonicalName): Positions {
    return this.#spaces.of(nameOf(name), () => readPositions(this.tables, this.#read, name));
  }
}

const nameOf = ({ group, tile, quality, tiers }: CanonicalName) => `${group} ${tile} ${quality} ${tiers}`;

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
  const ask = { path: ROOT_PATH, limit: MAX_ROOT_BYTES, attempts, patient, changing: true, accept };
  const batch = await fetchBatch(client, [ask], signal, () => {});
  return { ...batch, refused: [...batch.refused].map(([path, error]) => [path, toWire(error)]), tables };
}

function asFormatError(path: string, error: unknown): FormatError {
  if (error instanceof FormatError) return error;
  if (!(error instanceof MissingTableError || error instanceof RangeError)) throw error;
  return new FormatError("missing_entry", path, error.message);
}

// Decoding ahead of the screen: the segments of the schedule, one after another, a second of play at most. The tiles of a
// segment are decoded side by side; one that comes late is decoded at once, beside what is decoded then.
import { FormatError } from "../format/errors.ts";
import { Recent } from "../format/recent.ts";
import type { Atlas, Canonical, StateFrame } from "../format/types.ts";
import type { Media } from "../media/client.ts";
import type { Slot } from "./playout.ts";
import type { Shared } from "./receiver.ts";

const LEAD_S = 1; // of play that is decoded ahead: what is decoded can no longer be replaced by a better rung
const NOTHING = { luma: new Uint8Array(0), means: new Float32Array(0), time: 0 };
const MOST_SPACES = 2; // canonical spaces of each tile: of the group on the screen and of the next one

/** A tile of a segment that is decoded, or about to be. */
export interface Layer {
  readonly tile: number;
  readonly level: number;
  readonly canonical: Canonical;
  /** Of its pictures; of a segment that has none, it is not used. */
  readonly atlas: Atlas;
  /** One a frame: undefined is not decoded yet, null shows the canonical space. */
  readonly frames: (StateFrame | null | undefined)[];
  /** It came when decoding had begun, so that nobody waits for it. */
  readonly late: boolean;
  shown: number;
}

/** A segment that is decoded, or about to be, with the tiles that are there. */
export interface Clip {
  readonly position: number;
  /** Number of the rung whose files it is made of, late ones aside. */
  readonly rung: number;
  /** Of tiles with rows. */
  readonly layers: Layer[];
  /** That it has, or is about to have. */
  readonly tiles: Set<number>;
  /** The frame that was shown last; −1: none. */
  shown: number;
}

/** Whether a frame of a clip can be shown: all tiles that came in time are decoded. */
export const isDecoded = ({ layers }: Clip, frame: number): boolean =>
  layers.every(({ late, frames }) => late || frames[frame] !== undefined);

export interface PipelineParts extends Pick<Shared, "offers" | "stores" | "playout"> {
  media: Media;
  /** A frame has come, or a segment turned out to be of no use. */
  onProgress: () => void;
  onProblem: (error: unknown) => void;
}

/** Decodes what is scheduled. Clips stay until `drop` or `clear`. */
export class Pipeline {
  readonly #clips = new Map<number, Clip>();
  readonly #spaces: Recent<string, Canonical>;
  #stop = new AbortController();
  #working = false;

  constructor(private readonly parts: PipelineParts) {
    this.#spaces = new Recent(MOST_SPACES * parts.offers.tiles.length);
  }

  /** The clip of a position in the session, if it is decoded or on its way. */
  clip(position: number): Clip | undefined {
    return this.#clips.get(position);
  }

  get clips(): Iterable<Clip> {
    return this.#clips.values();
  }

  async wake(): Promise<void> {
    this.#addLate();
    if (this.#working) return;
    this.#working = true;
    const { signal } = this.#stop;
    for (let slot = this.#next(); slot; slot = this.#next()) {
      await this.#decode(slot, signal);
      if (signal.aborted) return;
    }
    this.#working = false;
  }

  /** The clips before a position, and the keys of earlier loops, are of no use any more. */
  drop(before: number): void {
    this.parts.stores.keys.forget(before);
    for (const [position, clip] of this.#clips) if (position < before) this.#drop(clip);
    this.wake();
  }

  /** A frame is on the screen, and those before it in its clip have passed. */
  shown(clip: Clip, frame: number): void {
    clip.shown = frame;
    for (const { frames, shown } of clip.layers) {
      const stop = frame + Number(shown === frame); // the one on the screen is still of use to a layer that lags behind
      for (let t = 0; t < stop; t++) this.#letGo(frames, t);
    }
    this.wake();
  }

  clear(): void {
    for (const clip of this.#clips.values()) this.#drop(clip);
    this.#stop.abort();
    this.#stop = new AbortController();
    this.#working = false;
  }

  #drop({ position, layers }: Clip): void {
    for (const { frames } of layers) for (let t = 0; t < frames.length; t++) this.#letGo(frames, t);
    this.#clips.delete(position);
  }

  /** Of a frame that has passed, the bases are still of use: later ones follow from them. */
  #letGo(frames: Layer["frames"], t: number): void {
    const frame = frames[t];
    if (!frame || frame.luma === NOTHING.luma) return;
    this.parts.media.taken(frame);
    frames[t] = { ...NOTHING, bases: frame.bases };
  }

  /** The next segment to decode: the first without a clip, unless enough is decoded. */
  #next(): Slot | null {
    const { playout, offers } = this.parts;
    const now = playout.at(performance.now() / 1e3);
    let ahead = now ? -now.frame / offers.fps : 0; // what has passed of the segment on the screen does not count
    for (const slot of playout.slots) {
      if (slot.rung === null || (now && slot.position < now.slot.position)) continue;
      if (!this.#clips.has(slot.position)) return ahead < LEAD_S ? slot : null;
      ahead += slot.seconds;
    }
    return null;
  }

  async #decode(slot: Slot, signal: AbortSignal): Promise<void> {
    const { playout, onProblem } = this.parts;
    const { position, rung } = slot;
    if (rung === null) return;
    playout.commit(position);
    const tiles = new Map(slot.tiles);
    try {
      const made = await Promise.all([...tiles].map(([tile, of]) => this.#layer(position, tile, of, false, signal)));
      const layers = made.filter((layer) => layer !== null);
      const clip: Clip = { position, rung, layers, shown: -1, tiles: new Set(tiles.keys()) };
      this.#clips.set(position, clip);
      this.#addLate();
      await Promise.all([...layers].map((layer) => this.#fill(clip, layer, signal)));
    } catch (error) {
      if (signal.aborted) return;
      onProblem(error);
      playout.lose(position);
    }
  }

  /** Begin to decode tiles that came when decoding their segment had begun. */
  #addLate(): void {
    for (const slot of this.parts.playout.slots) {
      const clip = this.#clips.get(slot.position);
      if (!clip) continue;
      for (const [tile, rung] of slot.tiles) if (!clip.tiles.has(tile)) this.#decodeLate(clip, tile, rung);
    }
  }

  async #decodeLate(clip: Clip, tile: number, rung: number): Promise<void> {
    clip.tiles.add(tile);
    const { signal } = this.#stop;
    try {
      const layer = await this.#layer(clip.position, tile, rung, true, signal);
      if (!layer || this.#clips.get(clip.position) !== clip) return;
      clip.layers.push(layer);
      await this.#fill(clip, layer, signal);
    } catch (error) {
      if (!signal.aborted) this.parts.onProblem(error);
    }
  }

  /** A tile of the segment at a position, in a rung; null: it has no rows. */
  async #layer(pos: number, tile: number, rung: number, late: boolean, signal: AbortSignal): Promise<Layer | null> {
    const { media, offers } = this.parts;
    const [quality, level] = offers.rungs[rung];
    const canonical = await this.#space(pos, quality, tile, signal);
    const { start, stop } = media.tables.segment(offers.index(pos));
    const atlas = media.tables.group(canonical.group).tiles[tile].levels[level];
    const frames = new Array(stop - start).fill(undefined);
    return canonical.depths.length ? { tile, level, canonical, atlas, frames, late, shown: -1 } : null;
  }

  async #fill(clip: Clip, layer: Layer, signal: AbortSignal): Promise<void> {
    const { media, offers, onProgress } = this.parts;
    const { canonical, level, frames } = layer;
    const take = (t: number, frame: StateFrame | null) => {
      if (this.#clips.get(clip.position) !== clip) return media.taken(frame); // its time has passed
      frames[t] = frame;
      if (t < clip.shown) this.#letGo(frames, t);
      onProgress();
    };
    await media.segment(offers.index(clip.position), level, canonical, take, signal);
  }

  /** The canonical space of a tile of the group of a position, of all tiers that are there. */
  async #space(position: number, quality: number, tile: number, signal: AbortSignal): Promise<Canonical> {
    const { media, offers, stores } = this.parts;
    const group = media.tables.groupOf(offers.index(position));
    const tiers = stores.keys.shownTiers(position, quality, tile);
    if (!tiers) throw new FormatError("missing_entry", `group ${group}`, "expected a key tier, got none");
    const name = `${group} ${tile} ${quality} ${tiers}`;
    const canonical = this.#spaces.get(name) ?? (await media.canonical({ group, tile, quality, tiers }, signal));
    signal.throwIfAborted();
    return this.#spaces.set(name, canonical);
  }
}

// Decoding ahead of the screen: the segments of the schedule, one after another, a second of play at most.
import type { Canonical, StateFrame } from "../format/types.ts";
import type { Media } from "../media/client.ts";
import type { Catalogue } from "./catalogue.ts";
import type { Clip } from "./clip.ts";
import type { Playout } from "./playout.ts";
import type { Slot } from "./slot.ts";
import type { KeyStore } from "./stores.ts";

const LEAD_S = 1; // of play that is decoded ahead: what is decoded can no longer be replaced by a better rung
const NOTHING = { luma: new Uint8Array(0), means: new Float32Array(0) };
const KEPT_SPACES = 2; // canonical spaces: of the group on the screen and of the next one

export interface PipelineParts {
  media: Media;
  catalogue: Catalogue;
  stores: { keys: KeyStore };
  playout: Playout;
  /** A frame has come, or a segment turned out to be of no use. */
  onProgress: () => void;
  onProblem: (error: unknown) => void;
}

/** Decodes what is scheduled. Clips stay until `drop` or `clear`. */
export class Pipeline {
  readonly #clips = new Map<number, Clip>();
  readonly #spaces = new Map<string, Canonical>();
  #stop = new AbortController();
  #working = false;

  constructor(private readonly parts: PipelineParts) {}

  /** The clip of a position in the session, if it is decoded or on its way. */
  clip(position: number): Clip | undefined {
    return this.#clips.get(position);
  }

  get clips(): Iterable<Clip> {
    return this.#clips.values();
  }

  /** Go on decoding if there is something to decode. */
  async wake(): Promise<void> {
    if (this.#working) return;
    this.#working = true;
    for (let slot = this.#next(); slot; slot = this.#next()) {
      this.#stop = new AbortController();
      const { signal } = this.#stop;
      await this.#decode(slot, signal);
      if (signal.aborted) return;
    }
    this.#working = false;
  }

  /** The clips before a position are of no use any more. */
  drop(before: number): void {
    for (const [position, clip] of this.#clips) if (position < before) this.#drop(clip);
    this.wake();
  }

  /** A frame is on the screen, and those before it in its clip have passed. */
  shown({ frames }: Clip, frame: number): void {
    for (let t = 0; t <= frame; t++) this.#letGo(frames, t);
    this.wake();
  }

  /** Forget all clips, and stop decoding. */
  clear(): void {
    for (const clip of this.#clips.values()) this.#drop(clip);
    this.#stop.abort();
    this.#working = false;
  }

  #drop({ position, frames }: Clip): void {
    for (let t = 0; t < frames.length; t++) this.#letGo(frames, t);
    this.#clips.delete(position);
  }

  /** Of a frame that has passed, the bases are still of use: later ones follow from them. */
  #letGo(frames: Clip["frames"], t: number): void {
    const frame = frames[t];
    if (!frame || frame.luma === NOTHING.luma) return;
    this.parts.media.taken(frame);
    frames[t] = { ...NOTHING, bases: frame.bases };
  }

  /** The next segment to decode: the first without a clip, unless enough is decoded. */
  #next(): Slot | null {
    const { playout, catalogue } = this.parts;
    const now = playout.at(performance.now() / 1e3);
    let ahead = now ? -now.frame / catalogue.fps : 0; // what has passed of the segment on the screen does not count
    for (const slot of playout.slots) {
      if (slot.rung === null || (now && slot.position < now.slot.position)) continue;
      if (!this.#clips.has(slot.position)) return ahead < LEAD_S ? slot : null;
      ahead += slot.seconds;
    }
    return null;
  }

  async #decode(slot: Slot, signal: AbortSignal): Promise<void> {
    const { media, catalogue, playout, onProblem } = this.parts;
    const { position, rung } = slot;
    if (rung === null) return;
    playout.commit(position);
    const [quality, level] = catalogue.rungs[rung];
    try {
      const canonical = await this.#space(position, quality, signal);
      const segment = catalogue.index(position);
      const { start, stop } = media.tables.segment(segment);
      const atlas = media.tables.group(canonical.group).levels[level];
      const frames = new Array(stop - start).fill(undefined);
      const clip: Clip = { position, rung, quality, level, canonical, atlas, frames };
      this.#clips.set(position, clip);
      await this.#fill(clip, segment, signal);
    } catch (error) {
      if (signal.aborted) return;
      onProblem(error);
      playout.lose(position);
    }
  }

  async #fill(clip: Clip, segment: number, signal: AbortSignal): Promise<void> {
    const { media, onProgress } = this.parts;
    const { position, canonical, quality, level } = clip;
    const of = { group: canonical.group, quality, tiers: canonical.tiers };
    const take = (t: number, frame: StateFrame | null) => {
      if (this.#clips.get(position) !== clip) return media.taken(frame); // its time has passed
      clip.frames[t] = frame;
      onProgress();
    };
    await media.segment(segment, level, of, take, signal);
  }

  /** The canonical space of the group of a position, of all tiers that are there. */
  async #space(position: number, quality: number, signal: AbortSignal): Promise<Canonical> {
    const { media, catalogue, stores } = this.parts;
    const group = media.tables.groupOf(catalogue.index(position));
    const tiers = stores.keys.shownTiers(position, quality);
    const name = `${group} ${quality} ${tiers}`;
    const canonical = this.#spaces.get(name) ?? (await media.canonical(group, quality, tiers, signal));
    signal.throwIfAborted();
    this.#spaces.delete(name);
    this.#spaces.set(name, canonical); // the last one used
    for (const old of [...this.#spaces.keys()].slice(0, -KEPT_SPACES)) this.#spaces.delete(old);
    return canonical;
  }
}

// Decoding ahead of the screen: the segments of the schedule, one after another, a second of play at most.
import { Recent } from "../format/collections.ts";
import { FormatError } from "../format/errors.ts";
import type { Atlas, Canonical, DeltaFrame } from "../format/types.ts";
import type { Media } from "../media/client.ts";
import type { Slot } from "./playout.ts";
import type { Shared } from "./session.ts";

const LEAD_S = 1; // of play that is decoded ahead: what is decoded can no longer be replaced by a better rung
const NOTHING = { luma: new Uint8Array(0), means: new Float32Array(0), time: 0 };
const MOST_SPACES = 2; // canonical spaces: of the group on the screen and of the next one

/** A segment that is decoded, or about to be. */
export interface Clip {
  readonly position: number;
  readonly rung: number;
  readonly level: number;
  readonly canonical: Canonical;
  /** Of its pictures; of a segment that has none, it is not used. */
  readonly atlas: Atlas;
  /** One a frame: undefined is not decoded yet, null shows the canonical space. */
  readonly frames: (DeltaFrame | null | undefined)[];
}

export interface PipelineParts extends Pick<Shared, "offers" | "stores" | "playout"> {
  media: Media;
  /** A frame has come, or a segment turned out to be of no use. */
  onProgress: () => void;
  onProblem: (error: unknown) => void;
}

/** Decodes what is scheduled. Clips stay until they have passed, or `clear`. */
export class Pipeline {
  readonly #clips = new Map<number, Clip>();
  readonly #spaces = new Recent<string, Canonical>(MOST_SPACES);
  /** What was due when the screen was looked at last: what the clock says meanwhile may be taken back by a hold. */
  #due = { position: 0, frame: 0 };
  #stop = new AbortController();
  #working = false;

  constructor(private readonly parts: PipelineParts) {}

  clip(position: number): Clip | undefined {
    return this.#clips.get(position);
  }

  get clips(): Iterable<Clip> {
    return this.#clips.values();
  }

  async wake(): Promise<void> {
    if (this.#working) return;
    this.#working = true;
    const { signal } = this.#stop;
    for (let slot = this.#next(); slot; slot = this.#next()) {
      await this.#decode(slot, signal);
      if (signal.aborted) return;
    }
    this.#working = false;
  }

  /** A frame is due on the screen: the clips before it, and the keyframes of earlier loops, are of no use any more. */
  due(position: number, frame: number): void {
    this.#due = { position, frame };
    this.parts.stores.keyframes.forget(position);
    for (const [before, clip] of this.#clips) if (before < position) this.#drop(clip);
    this.wake();
  }

  /** A frame is on the screen, and those before it in its clip have passed. */
  shown(clip: Clip, frame: number): void {
    for (let t = 0; t <= frame; t++) this.#letGo(clip.frames, t);
    this.wake();
  }

  clear(): void {
    for (const clip of this.#clips.values()) this.#drop(clip);
    this.#stop.abort();
    this.#stop = new AbortController();
    this.#due = { position: 0, frame: 0 };
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
    const { playout, offers } = this.parts;
    const { position, frame } = this.#due;
    let ahead = -frame / offers.fps; // what has passed of the segment on the screen does not count
    for (const slot of playout.slots) {
      if (slot.rung === null || slot.position < position) continue;
      if (!this.#clips.has(slot.position)) return ahead < LEAD_S ? slot : null;
      ahead += slot.seconds;
    }
    return null;
  }

  async #decode(slot: Slot, signal: AbortSignal): Promise<void> {
    const { media, offers, playout, onProgress, onProblem } = this.parts;
    const { position, rung } = slot;
    if (rung === null) return;
    playout.commit(position);
    try {
      const segment = offers.index(position);
      const [quality, level] = offers.rungs[rung];
      const canonical = await this.#space(position, quality, signal);
      const { start, stop } = media.tables.segment(segment);
      const atlas = media.tables.group(canonical.group).levels[level];
      const frames: Clip["frames"] = new Array(stop - start).fill(undefined);
      const clip: Clip = { position, rung, level, canonical, atlas, frames };
      this.#clips.set(position, clip);
      const take = (t: number, frame: DeltaFrame | null) => {
        if (this.#clips.get(position) !== clip) return media.taken(frame); // its time has passed
        frames[t] = frame;
        onProgress();
      };
      const done = media.segment(segment, level, canonical, take, signal, playout.skipped(slot));
      onProgress(); // its scene is made meanwhile
      await done;
    } catch (error) {
      if (signal.aborted) return;
      onProblem(error);
      playout.lose(position);
    }
  }

  async #space(position: number, quality: number, signal: AbortSignal): Promise<Canonical> {
    const { media, offers, stores } = this.parts;
    const group = media.tables.groupOf(offers.index(position));
    const tiers = stores.keyframes.shownTiers(position, quality);
    if (!tiers) throw new FormatError("missing_entry", `group ${group}`, "expected a keyframe tier, got none");
    const name = `${group} ${quality} ${tiers}`;
    const canonical = this.#spaces.get(name) ?? (await media.canonical({ group, quality, tiers }, signal));
    signal.throwIfAborted();
    return this.#spaces.set(name, canonical);
  }
}

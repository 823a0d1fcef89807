// Frames of packages as Gaussians, without a player, for adapters (web/adapters) and programs of one's own.
import { basesAfter } from "./format/atlas.ts";
import { Recent } from "./format/collections.ts";
import { canonicalGaussians, shownGaussians } from "./format/gaussians.ts";
import { levelled } from "./format/region.ts";
import type { Canonical, DeltaFrame, Gaussians, Region, Root, Segment, World } from "./format/types.ts";
import { Media } from "./media/client.ts";

export { FormatError, type Reason } from "./format/errors.ts";
export type { Gaussians, Place, Region, Root, World } from "./format/types.ts";
export { TransportError, UnsupportedError } from "./media/errors.ts";

/** Opens a package to read its frames as Gaussians. Throws what `Player.open` does. */
export const openFrames = async (src: string): Promise<FrameReader> => new FrameReader(await Media.open(src));

interface Decoded {
  segment: Segment;
  level: number;
  canonical: Canonical;
  base: Gaussians;
  frames: (DeltaFrame | null)[];
}

/** Reads frames of a package, in any order; one after the other is fastest, since a segment is decoded as a whole. */
export class FrameReader {
  readonly #held = new Recent<string, Promise<Decoded>>(2);
  #last: Promise<Decoded> | null = null;

  constructor(private readonly media: Media) {}

  get root(): Root {
    return this.media.tables.root;
  }

  get frames(): number {
    return this.root.frames;
  }

  get fps(): number {
    return this.root.frame_rate[0] / this.root.frame_rate[1];
  }

  /** Where the quality of the package is promised. */
  get region(): Region {
    return levelled(this.root);
  }

  /** Where the scene stands in a world with y up, as far as somebody told. */
  get world(): World | null {
    return this.root.world ?? null;
  }

  get rungs(): string[] {
    const { qualities, levels } = this.root;
    return qualities.flatMap((quality) => levels.map((level) => `${quality.id}+${level.id}`));
  }

  /** A frame in a rung, by default the first one, which is the best.
   *
   * Throws RangeError for a frame or rung that there is not, FormatError and TransportError where a file cannot be had.
   */
  async gaussians(frame: number, rung = this.rungs[0]): Promise<Gaussians> {
    const { segment, level, canonical, base, frames } = await this.#segment(frame, rung);
    const table = this.media.tables.group(canonical.group);
    const state = frames[frame - segment.start];
    if (!state) return shownGaussians(this.root, table, base, canonical, null);
    const changes = frames.slice(0, frame - segment.start + 1).map((one) => one?.bases ?? null);
    const bases = basesAfter(state.luma.length, changes);
    const slopes = changes[0]?.slopes ?? null;
    return shownGaussians(this.root, table, base, canonical, { ...state, level, bases, slopes });
  }

  /** Hands each frame to `show` at its time or not at all, over and over until an abort. Throws what `gaussians` does. */
  async play(
    show: (gaussians: Gaussians, frame: number) => void,
    { rung = this.rungs[0], signal }: { rung?: string | undefined; signal?: AbortSignal } = {},
  ): Promise<void> {
    const begun = performance.now();
    for (let shown = -1; !signal?.aborted; await new Promise(requestAnimationFrame)) {
      const frame = Math.floor(((performance.now() - begun) / 1000) * this.fps) % this.frames;
      if (frame === shown) continue;
      show(await this.gaussians(frame, rung), frame);
      shown = frame;
      const { segment } = await this.#segment(frame, rung);
      this.#segment(segment.stop % this.frames, rung).catch(() => {}); // the next one, ahead of its time
    }
  }

  close(): void {
    this.media.close();
  }

  async #segment(frame: number, rung: string): Promise<Decoded> {
    const number = this.rungs.indexOf(rung);
    if (number < 0) throw new RangeError(`rung: expected one of ${this.rungs.join(", ")}, got ${rung}`);
    if (!(frame >= 0 && frame < this.frames))
      throw new RangeError(`frame: expected 0 … ${this.frames - 1}, got ${frame}`);
    const segment = await this.media.locate(frame, new AbortController().signal);
    const name = `${segment} ${number}`;
    const held = this.#held.get(name);
    if (held) return held;
    this.#last = this.#decode(segment, number, this.#last);
    this.#last.catch(() => this.#held.delete(name)); // another try fetches it again
    return this.#held.set(name, this.#last);
  }

  async #decode(segment: number, rung: number, before: Promise<Decoded> | null): Promise<Decoded> {
    const { tables } = this.media;
    const { levels } = tables.root;
    const [quality, level] = [Math.floor(rung / levels.length), rung % levels.length];
    const { tiers } = levels[level];
    const group = tables.groupOf(segment);
    const last = (await before?.catch(() => null)) ?? null;
    const known = last?.canonical;
    const same = known?.group === group && known.quality === quality && known.tiers >= tiers ? last : null;
    const canonical = same?.canonical ?? (await this.media.canonical({ group, quality, tiers }));
    const base = same?.base ?? canonicalGaussians(tables.root, tables.group(group), canonical);
    const frames: (DeltaFrame | null)[] = [];
    await this.media.segment(segment, level, canonical, (t, frame) => {
      frames[t] = frame;
      this.media.taken(frame);
    });
    return { segment: tables.segment(segment), level, canonical, base, frames };
  }
}

// Figures of a session, for viewers who want to see them.
import type { Arrived } from "./downloader.ts";
import type { Clip } from "./pipeline.ts";
import type { Playout } from "./playout.ts";
import type { Cause } from "./policies/drops.ts";

const DISPLAY_WINDOW_S = 2; // over which pictures a second are counted

export interface PlayerStats {
  /** bit/s of the last segments, as policies estimate it; 0: not known yet. */
  throughputBps: number;
  bufferS: number;
  rung: number | null;
  bytes: number;
  framesShown: number;
  /** Times of frames that passed without a new one: by decoder and display, and in segments that were lost. */
  framesDropped: number;
  droppedByDecoder: number;
  droppedByDisplay: number;
  displayFps: number;
  /** What the package claims of the segment on the screen in its rung, dB. */
  psnr: number | null;
  /** Waits for bytes after playing began, and their seconds. */
  stalls: number;
  stallS: number;
  /** The best rung that is chosen now, since frames of better ones were dropped, and by what; null: any may be. */
  held: { rung: number; by: Cause } | null;
  /** What this browser does to the luma of pictures. */
  luma: "exact" | "invertible" | null;
}

export class Statistics {
  #bytes = 0;
  #throughputBps = 0;
  #shown = 0;
  #lost = 0;
  #late = 0;
  waiting = false;
  #drawn: number[] = [];
  #pictures = 0;

  arrived({ arrival, throughputBps }: Arrived): void {
    this.#bytes += arrival.cached ? 0 : arrival.bytes;
    this.#throughputBps = throughputBps || this.#throughputBps;
  }

  /** A frame is to be drawn; the time of those before it has passed, and also of the last one if it waits still. */
  shown({ lost, late }: { lost: number; late: number }): void {
    this.#lost += lost;
    this.#late += late + Number(this.waiting);
    this.waiting = true;
  }

  /** A picture was drawn; whether it was the first one. */
  drawn(nowS: number): boolean {
    this.#shown += Number(this.waiting);
    this.waiting = false;
    this.#drawn.push(nowS);
    while (this.#drawn[0] < nowS - DISPLAY_WINDOW_S) this.#drawn.shift();
    return this.#pictures++ === 0;
  }

  dropped(playout: Playout | null): Record<Cause, number> {
    const { decoder, display } = playout?.missed ?? { decoder: 0, display: 0 };
    return { decoder, display: display + this.#late };
  }

  read(
    nowS: number,
    playout: Playout | null,
    luma: PlayerStats["luma"],
    clip: Clip | null,
    held: PlayerStats["held"] = null,
  ): PlayerStats {
    const segment = playout && clip ? playout.offers.index(clip.position) : null;
    const known = playout?.offers.measured && segment !== null && playout.offers.knows(segment);
    const { decoder, display } = this.dropped(playout);
    const lately = this.#drawn.filter((atS) => atS > nowS - DISPLAY_WINDOW_S);
    return {
      throughputBps: this.#throughputBps,
      bufferS: playout?.bufferS(nowS) ?? 0,
      rung: clip?.rung ?? null,
      bytes: this.#bytes,
      framesShown: this.#shown,
      framesDropped: decoder + display + this.#lost,
      droppedByDecoder: decoder,
      droppedByDisplay: display,
      displayFps: lately.length / DISPLAY_WINDOW_S,
      psnr: known && clip ? playout.offers.of(segment).rungs[clip.rung].psnr : null,
      stalls: playout?.stalls ?? 0,
      stallS: playout?.stallS ?? 0,
      held,
      luma,
    };
  }
}

// Figures of a session, for viewers who want to see them.

import type { Arrived } from "./downloader.ts";
import type { Offers } from "./offers.ts";
import type { Clip } from "./pipeline.ts";
import type { Playout } from "./playout.ts";

const DISPLAY_WINDOW_S = 2; // over which pictures a second are counted

/** Figures of a player at one moment. */
export interface PlayerStats {
  /** bit/s of the last segments, as policies estimate it; 0: not known yet. */
  throughputBps: number;
  /** Seconds of play that are at hand. */
  bufferS: number;
  /** Number of the rung on the screen. */
  rung: number | null;
  /** That came over the network, headers included. */
  bytes: number;
  /** Frames of the sequence that were on the screen, and those whose time passed before they could be. */
  framesShown: number;
  framesDropped: number;
  /** Pictures a second that were drawn lately. */
  displayFps: number;
  /** What the package claims of the segment on the screen in its rung, dB. */
  psnr: number | null;
  stalls: number;
  stallS: number;
  /** Tiles of the scene that are on the screen, and how many there are; null: not known. */
  tiles: { shown: number; all: number } | null;
  /** What this browser does to the luma of pictures. */
  luma: "exact" | "invertible" | null;
}

/** Of the tiles of a clip that have rows: those on the screen, and all. */
function tilesOf(offers: Offers, { layers, shown, position }: Clip): PlayerStats["tiles"] {
  const segment = offers.index(position);
  if (!offers.knows(segment)) return null;
  const there = layers.filter((layer) => layer.shown === shown);
  return { shown: there.length, all: offers.tilesWithRows(segment).length };
}

/** Counts what happens. */
export class Statistics {
  #bytes = 0;
  #throughputBps = 0;
  #shown = 0;
  #dropped = 0;
  #drawn: number[] = [];
  #pictures = 0;

  arrived({ arrival, throughputBps }: Arrived): void {
    this.#bytes += arrival.cached ? 0 : arrival.bytes;
    this.#throughputBps = throughputBps || this.#throughputBps;
  }

  /** A frame is on the screen; the time of so many before it passed without them. */
  shown(passedOver: number): void {
    this.#shown++;
    this.#dropped += passedOver;
  }

  /** A picture was drawn; whether it was the first one. */
  drawn(nowS: number): boolean {
    this.#drawn.push(nowS);
    while (this.#drawn[0] < nowS - DISPLAY_WINDOW_S) this.#drawn.shift();
    return this.#pictures++ === 0;
  }

  read(nowS: number, playout: Playout | null, luma: PlayerStats["luma"], clip: Clip | null): PlayerStats {
    const segment = playout && clip ? playout.offers.index(clip.position) : null;
    const known = playout?.offers.measured && segment !== null && playout.offers.knows(segment);
    const lately = this.#drawn.filter((atS) => atS > nowS - DISPLAY_WINDOW_S);
    return {
      throughputBps: this.#throughputBps,
      bufferS: playout?.bufferS(nowS) ?? 0,
      rung: clip?.rung ?? null,
      bytes: this.#bytes,
      framesShown: this.#shown,
      framesDropped: this.#dropped,
      displayFps: lately.length / DISPLAY_WINDOW_S,
      psnr: known && clip ? playout.offers.of(segment).rungs[clip.rung].psnr : null,
      stalls: playout?.stalls ?? 0,
      stallS: playout?.stallS ?? 0,
      tiles: playout && clip && tilesOf(playout.offers, clip),
      luma,
    };
  }
}

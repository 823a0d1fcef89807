// The part of a session that fetches: one batch at a time, and what arrives is taken in.
import { isSound } from "../format/paths.ts";
import { REMEMBERED, SHORTEST_S } from "../generated/constants.ts";
import type { Arrival, Arrived, Downloader, GiveUp, Request } from "./downloader.ts";
import type { Offers } from "./offers.ts";
import type { Playout } from "./playout.ts";
import type { Download, Policy } from "./policies/state.ts";
import type { SessionSettings } from "./settings.ts";
import type { Stores } from "./stores.ts";

/** What fetches and shows share of a package. */
export interface Shared {
  offers: Offers;
  settings: SessionSettings;
  playout: Playout;
  stores: Stores;
}

export interface SessionParts extends Shared {
  downloader: Downloader;
  policy: Policy;
}

/** Fetches for a session until the signal aborts. */
export class Receiver {
  /** When the last batch was over, or when there was room for the next. */
  nowS: number;

  constructor(
    private readonly parts: SessionParts,
    readonly signal: AbortSignal,
  ) {
    this.nowS = parts.downloader.now();
  }

  /** Wait until a moment; less long where the playout changes, or the signal aborts. */
  async wait(untilS: number): Promise<void> {
    await this.parts.downloader.wait(untilS, this.parts.playout, this.signal);
    this.nowS = this.parts.downloader.now();
  }

  async fetchTables(tables: readonly string[], position: number): Promise<Arrived> {
    const batch = { keys: [], state: [], tables };
    const { rttS } = this.parts.downloader;
    const arrival = await this.receive(
      { kind: "tables", position, rung: 0, batch, sentS: this.nowS, latencyS: rttS },
      null,
    );
    return { type: "arrived", arrival, throughputBps: 0 };
  }

  /** The last downloads that are over when a request is sent, oldest first; before there is one, the tables. */
  history(sentS: number): Download[] {
    const { downloads, first } = this.parts.stores;
    const past = downloads.slice(-REMEMBERED).filter(({ atS }) => atS <= sentS + SHORTEST_S);
    return past.length ? past.map(({ download }) => download) : [first];
  }

  /** Fetch a batch and take in what is of use; time goes on. */
  async receive(request: Request, giveUp: GiveUp | null): Promise<Arrival> {
    const { downloader, stores } = this.parts;
    const arrival = await downloader.fetch(request, giveUp, this.signal);
    for (const path of arrival.refused.keys()) if (!isSound(path)) stores.unusable.add(path);
    this.nowS = arrival.atS;
    stores.tables.add(arrival);
    if (request.kind === "tables") {
      if (!arrival.cached)
        this.bound({ bytes: arrival.bytes, seconds: Math.max(arrival.atS - request.sentS, SHORTEST_S) });
      return arrival;
    }
    if (!arrival.cached && !this.signal.aborted) {
      const { atS, firstByteS, bytes } = arrival;
      stores.downloads.push({ atS, download: { bytes, seconds: Math.max(atS - firstByteS, SHORTEST_S) } });
      if (stores.downloads.length > REMEMBERED) stores.downloads.shift();
    }
    stores.keys.add(arrival);
    this.useKeys(request);
    return arrival;
  }

  /** What comes in one burst is too short to tell the rate, but not that it is no less. */
  private bound(download: Download): void {
    const { stores } = this.parts;
    if (download.bytes / download.seconds > stores.first.bytes / stores.first.seconds) stores.first = download;
  }

  /** Show what is buffered of a group with its best keys, where they are decoded in time. */
  private useKeys({ position, rung }: Request): void {
    const { offers, playout, settings, stores } = this.parts;
    const { levels } = offers.tables.root;
    const quality = offers.rungs[rung][0];
    const groupOf = (place: { loop: number; segment: number }) =>
      `${place.loop}: ${offers.tables.groupOf(place.segment)}`;
    const group = groupOf(offers.place(position));
    for (const slot of playout.pending()) {
      const inTime = playout.startS(slot, this.nowS) >= this.nowS + settings.decodeFrameS;
      if (!inTime || groupOf(offers.place(slot.position)) !== group) continue;
      const [shownQuality, level] = offers.rungs[slot.rung ?? 0];
      if (quality < shownQuality && stores.keys.shownTiers(position, quality) >= levels[level].tiers) {
        playout.replace(slot, quality * levels.length + level);
      }
    }
  }
}

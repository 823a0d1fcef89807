// What segments turn out to lack soon before they are shown, or while they are: tiles that come into sight. They are
// fetched beside whatever a session fetches, since nothing is as urgent.
import { LOOK_S } from "../generated/constants.ts";
import { TransportError } from "../media/errors.ts";
import { type Arrived, type Downloader, type GiveUp, isComplete, type Request } from "./downloader.ts";
import type { Lack } from "./fetch-plan.ts";
import type { Option } from "./ladder.ts";
import { type Batch, filesOf } from "./offers.ts";
import type { Slot } from "./playout.ts";
import { estimateThroughput } from "./policies/state.ts";
import { fetchBatch, type Shared } from "./receiver.ts";
import { usable } from "./replacing.ts";

/** After a link has failed, seconds. */
const RETRY_S = 1;
/** As many connections as browsers open to a server over HTTP/1.1. */
const MOST_AT_ONCE = 6;

export interface RepairParts extends Shared {
  downloader: Downloader;
  onEvent: (event: Arrived) => void;
  /** Something went wrong that is not the link. */
  onProblem: (error: unknown) => void;
}

/** Fetches tiles that are lacking until the signal aborts, or looking fails. */
export class Repairs {
  /** Of position and tile: what is on its way, and what came to nothing. */
  readonly #underWay = new Set<string>();
  readonly #noUse = new Set<string>();
  #restS = Number.NEGATIVE_INFINITY;

  constructor(
    private readonly parts: RepairParts,
    readonly signal: AbortSignal,
  ) {}

  async run(): Promise<void> {
    const { downloader, playout } = this.parts;
    try {
      while (!this.signal.aborted) {
        const nowS = downloader.now();
        if (nowS >= this.#restS) this.look(nowS);
        await downloader.wait(nowS + LOOK_S, playout, this.signal);
      }
    } catch (error) {
      this.#failed(error);
    }
  }

  /** Begin to fetch what is lacking at a moment and can be had. */
  look(nowS: number): void {
    for (const lack of this.parts.planner.lacking(nowS)) {
      if (this.#underWay.size >= MOST_AT_ONCE) return;
      const name = nameOf(lack);
      if (this.#underWay.has(name) || this.#noUse.has(name)) continue;
      const option = this.option(lack, nowS);
      if (option) this.#repair(lack, option, nowS);
    }
  }

  /** A tile in the rung of its segment, or else in the smallest; null: not in time, or on its way. */
  option({ slot, tile }: Lack, nowS: number): Option | null {
    const { downloader, playout, stores } = this.parts;
    const atS = nowS + downloader.rttS + playout.settings.decodeFrameS;
    const missing = (rung: number) => stores.keys.missing(slot.position, rung, [tile]);
    const options = stores.keys.options(slot.position, [tile]).filter(({ index }) => usable(stores, missing(index)));
    const rateBps = estimateThroughput(stores.downloads.map(({ download }) => download)) || Infinity;
    const endS = this.#endS(slot, nowS);
    const wanted = options.find(({ index }) => index === slot.rung);
    const smallest = options.reduce<Option | null>((a, b) => (a && a.sizeBytes <= b.sizeBytes ? a : b), null);
    const chosen = [wanted, smallest].find((option) => option && atS + (8 * option.sizeBytes) / rateBps < endS) ?? null;
    return chosen && filesOf(missing(chosen.index)).some((path) => stores.coming.has(path)) ? null : chosen;
  }

  /** When a segment is over; Infinity while nobody knows, since the schedule stands still. */
  #endS(slot: Slot, nowS: number): number {
    const { playout } = this.parts;
    return playout.held ? Infinity : playout.endS(slot, nowS);
  }

  #failed(error: unknown): void {
    if (!this.signal.aborted) this.parts.onProblem(error);
  }

  async #repair(lack: Lack, option: Option, nowS: number): Promise<void> {
    const { playout, stores } = this.parts;
    const { slot, tile } = lack;
    const name = nameOf(lack);
    this.#underWay.add(name);
    try {
      const batch = stores.keys.missing(slot.position, option.index, [tile]);
      const came = !filesOf(batch).length || (await this.#fetch(slot, tile, option, batch, nowS));
      if (came && !this.signal.aborted) playout.addTile(slot, tile, option.index);
    } catch (error) {
      if (error instanceof TransportError) {
        this.#restS = this.parts.downloader.now() + RETRY_S; // the session tells of it
      } else {
        this.#noUse.add(name);
        this.#failed(error);
      }
    } finally {
      this.#underWay.delete(name);
    }
  }

  /** Fetches a tile; false: it did not come, or not whole. */
  async #fetch(slot: Slot, tile: number, option: Option, batch: Batch, sentS: number): Promise<boolean> {
    const { downloader, stores, onEvent } = this.parts;
    const rung = option.index;
    const request: Request = { kind: "repair", position: slot.position, rung, batch, sentS, latencyS: downloader.rttS };
    /** At the rate so far it would come after its segment. */
    const tooLate: GiveUp = ({ atS, elapsedS, bytes, expectedBytes }) =>
      atS + ((expectedBytes - bytes) * elapsedS) / Math.max(1, bytes) > this.#endS(slot, atS);
    const arrival = await fetchBatch(this.parts, request, tooLate, this.signal);
    stores.keys.add(arrival);
    onEvent({ type: "arrived", arrival, throughputBps: 0 });
    if (arrival.abandoned) this.#noUse.add(nameOf({ slot, tile }));
    return isComplete(arrival);
  }
}

const nameOf = ({ slot, tile }: Lack) => `${slot.position} ${tile}`;

// A viewer: requests, arrivals, choices and what is on the screen, as a stream of events.
//
// One batch passes at a time: those keyframe tiers of the chosen rung that are not decoded, then the delta segment.
// When nothing more fits the buffer, a buffered segment may be replaced by a better rung that will be there in time. A
// segment none of whose rungs can be had, or whose table cannot, is lost, and the session goes on. A package that grows
// is played until airgs.json says that nothing will follow, or nothing has followed for SILENCE_S.
import { isPage, isSound } from "../format/paths.ts";
import {
  LONGEST_POLL_S,
  POLL_S,
  REMEMBERED,
  REPLACE_GAIN_DB,
  ROOT_PATH,
  SAFETY,
  SHORTEST_S,
  SILENCE_S,
} from "../generated/constants.ts";
import { TransportError } from "../media/errors.ts";
import {
  type Arrival,
  type Arrived,
  type Downloader,
  type GiveUp,
  isComplete,
  type Request,
  type SessionEvent,
  type Shown,
} from "./downloader.ts";
import type { Decision, Option } from "./ladder.ts";
import { type Batch, ConfigError, filesOf, type Offers } from "./offers.ts";
import type { Playout, SessionSettings, Slot } from "./playout.ts";
import { type Download, estimateThroughput, type PlayerState, type Policy } from "./policies/state.ts";
import type { Stores } from "./stores.ts";

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

type Events<Result = void> = AsyncGenerator<SessionEvent, Result>;

/** One run over positions; after a seek or another policy, a new one goes on with the same stores. */
export class Session {
  /** When the last batch was over, or when there was room for the next. */
  private nowS: number;
  private givenUp = { position: Number.NaN, sizeBytes: 0 }; // nothing as large is asked for there again

  /** `first` is where it begins. Throws ConfigError where the policy needs quality that was not measured. */
  constructor(
    private readonly parts: SessionParts,
    private readonly signal: AbortSignal,
    private readonly first = 0,
  ) {
    const { policy, offers, downloader } = parts;
    if (policy.adapts && !offers.measured) {
      throw new ConfigError(`policy ${policy.name}: expected a package with measured quality`);
    }
    this.nowS = downloader.now();
  }

  async *run(): Events {
    const { playout, stores } = this.parts;
    const { first } = this;
    if (stores.rootS === null) yield* this.fetchRoot(first, false);
    else if (this.parts.offers.live) yield* this.fetchPages(first);
    for (let position = first; !this.stopped; position++) {
      if (position >= playout.end && !(yield* this.grow(position))) break;
      // A page first, then the tables that it leads to.
      for (let paths = this.wantedTables(position); paths.length && !this.stopped; paths = this.wantedTables(position))
        yield await this.receiveTables(paths, position);
      yield* this.roomFor(position);
      while (!this.stopped && !(yield* this.fetchNext(position)));
      if (!this.stopped) yield* this.shown(playout.started(this.nowS));
    }
    while (!this.stopped && (yield* this.replaceBest()));
    if (!this.stopped) yield* this.shown(playout.started(null));
  }

  private get stopped(): boolean {
    return this.signal.aborted;
  }

  private async *roomFor(position: number): Events {
    const { playout } = this.parts;
    for (;;) {
      playout.makeRoom(position);
      const earliestS = playout.earliestRequestS(position, this.nowS);
      if (this.nowS >= earliestS || this.stopped) return;
      if (yield* this.replaceBest()) continue;
      await this.wait(earliestS);
    }
  }

  /** Wait until a growing package has a segment for a position; false: it has ended before. */
  private async *grow(position: number): Events<boolean> {
    const { offers: c, playout, stores } = this.parts;
    const sinceS = this.nowS;
    for (let inVain = 0; c.live && c.end(1) <= position && !this.stopped; inVain++) {
      if (this.nowS >= sinceS + SILENCE_S) {
        yield { type: "cut", atS: this.nowS, why: `no group has followed for ${SILENCE_S} s` };
        break;
      }
      const newest = c.tables.index.entry(c.tables.index.groups - 1);
      const pauseS = Math.max(POLL_S, (newest.stop - newest.start) / c.fps);
      const longerS = Math.min(pauseS * 2 ** Math.min(inVain - 1, 8), LONGEST_POLL_S); // where it has not changed
      const askS = Math.max(this.nowS, (stores.rootS ?? 0) + Math.max(pauseS, longerS));
      while (this.nowS < askS && !this.stopped) {
        if (yield* this.replaceBest()) continue;
        await this.wait(askS);
      }
      yield* this.shown(playout.started(this.nowS));
      if (!this.stopped) yield* this.fetchRoot(position, true);
    }
    if (c.end(1) > position) {
      playout.end = Math.max(playout.end, c.end(1));
      return true;
    }
    if (!this.stopped) playout.finish(this.nowS);
    return false;
  }

  /** Fetch airgs.json, and, as a package grows, the pages that now say what the root said before. */
  private async *fetchRoot(position: number, grew: boolean): Events {
    this.parts.stores.rootS = this.nowS;
    yield await this.receiveTables([ROOT_PATH], position);
    if (grew || this.parts.offers.live) yield* this.fetchPages(position);
  }

  private async *fetchPages(position: number): Events {
    const { offers, playout, stores } = this.parts;
    const { tables, unusable } = stores;
    const from = Math.max(0, Math.min(playout.slots[0]?.position ?? position, position - 1));
    const missing = () => tables.missing(from, Math.min(position + 1, offers.end(1))).filter(isPage);
    for (let pages = missing(); pages.length && !this.stopped; pages = missing()) {
      yield await this.receiveTables(pages, position);
      if (pages.some((path) => unusable.has(path))) {
        throw new TransportError(`${pages.join(", ")}: expected the index of the growing package`);
      }
    }
  }

  private wantedTables(position: number): string[] {
    const { policy, playout, stores } = this.parts;
    const stop = Math.min(position + policy.horizon, playout.end);
    return stores.tables.missing(position, stop).filter((path) => !stores.unusable.has(path));
  }

  /** Choose a rung of the next segment and fetch it; false: it did not come whole, choose again. */
  private async *fetchNext(position: number): Events<boolean> {
    const { offers, playout, policy, stores } = this.parts;
    const state = stores.tables.has(position) ? this.state(position) : null;
    if (!state?.options.length) {
      if (position === this.first) offers.checkBudget(position);
      yield { type: "lost", position, atS: this.nowS };
      playout.enqueue(position, null, this.nowS);
      return true;
    }
    const decision = policy.choose(state);
    const tables = position > this.first ? this.wantedTables(position + 1) : []; // nothing delays the first picture
    const batch = { ...stores.keyframes.missing(position, decision.index), tables };
    if (filesOf(batch).length) {
      // Without files nothing moves: the canonical space is decoded.
      const kind = batch.keyframes.length ? "group" : "delta";
      const request: Request = { kind, position, rung: decision.index, batch, sentS: this.nowS };
      const arrival = await this.receive(request, this.giveUp(state, decision));
      yield { type: "arrived", arrival, throughputBps: estimateThroughput(state.history) };
      if (arrival.abandoned) this.givenUp = { position, sizeBytes: decision.sizeBytes };
      if (this.stopped || !isComplete(arrival)) return false;
    }
    playout.enqueue(position, decision.index, this.nowS);
    return true;
  }

  private state(position: number): PlayerState {
    const { downloader, offers, playout, policy, settings, stores } = this.parts;
    return {
      ahead: offers.upcoming(position, Math.min(position + policy.horizon, playout.end)),
      decoded: stores.keyframes.decoded(position),
      options: this.options(position),
      nowS: this.nowS,
      deadlineS: playout.deadlineS(playout.dueAt(this.nowS), this.nowS),
      bufferLimitS: settings.bufferS,
      requestLatencyS: downloader.rttS,
      shownQuality: playout.last && slotQuality(offers, playout.last),
      history: this.history(),
      speed: playout.schedule.speed,
    };
  }

  private options(position: number): readonly Option[] {
    const { stores } = this.parts;
    const most = this.givenUp.position === position ? this.givenUp.sizeBytes : Infinity;
    const options = stores.keyframes.options(position);
    return options.filter((p) => p.sizeBytes < most && usable(stores, stores.keyframes.missing(position, p.index)));
  }

  /** Abandon a download that would come late, and later than the smallest rung requested now; a pause puts that off. */
  private giveUp(state: PlayerState, decision: Decision): GiveUp | null {
    const { downloader, playout, policy, settings } = this.parts;
    const smallest = Math.min(...state.options.map((option) => option.sizeBytes));
    if (!(settings.abandon && policy.adapts) || smallest >= decision.sizeBytes) return null;
    const { nowS } = this;
    const dueAt = playout.dueAt(nowS);
    const { rttS } = downloader;
    return ({ atS, elapsedS, bytes, expectedBytes }) => {
      const deadlineS = Math.max(playout.deadlineS(dueAt, atS), nowS);
      const rate = Math.max(bytes, 1) / elapsedS;
      const leftS = (expectedBytes - bytes) / rate;
      return atS + leftS > deadlineS && leftS > rttS + smallest / rate;
    };
  }

  private async wait(untilS: number): Promise<void> {
    await this.parts.downloader.wait(untilS, this.parts.playout, this.signal);
    this.nowS = this.parts.downloader.now();
  }

  private async receiveTables(tables: readonly string[], position: number): Promise<Arrived> {
    const batch = { keyframes: [], delta: [], tables };
    const arrival = await this.receive({ kind: "tables", position, rung: 0, batch, sentS: this.nowS }, null);
    return { type: "arrived", arrival, throughputBps: 0 };
  }

  /** The last downloads, oldest first; before there is one, the tables. */
  private history(): readonly Download[] {
    const { downloads, first } = this.parts.stores;
    return downloads.length ? [...downloads] : [first];
  }

  private async receive(request: Request, giveUp: GiveUp | null): Promise<Arrival> {
    const { downloader, stores } = this.parts;
    const arrival = await downloader.fetch(request, giveUp, this.signal);
    for (const [path, why] of arrival.refused) if (!isSound(path)) stores.unusable.set(path, why);
    this.nowS = arrival.atS;
    stores.tables.add(arrival);
    const { atS, firstByteS, bytes } = arrival;
    if (request.kind === "tables") {
      const bound = { bytes, seconds: Math.max(atS - request.sentS, SHORTEST_S) };
      // What comes in one burst is too short to tell the rate, but not that it is no less; airgs.json came before.
      const asked = !arrival.cached && atS > request.sentS;
      if (asked && bytes / bound.seconds > stores.first.bytes / stores.first.seconds) stores.first = bound;
      return arrival;
    }
    if (!arrival.cached && !this.signal.aborted) {
      stores.downloads.push({ bytes, seconds: Math.max(atS - firstByteS, SHORTEST_S) });
      if (stores.downloads.length > REMEMBERED) stores.downloads.shift();
    }
    stores.keyframes.add(arrival);
    this.useKeyframes(request);
    return arrival;
  }

  /** Show what is buffered of a group with its best keyframes, where they are decoded in time. */
  private useKeyframes({ position, rung }: Request): void {
    const { offers, playout, settings, stores } = this.parts;
    const { levels } = offers.tables.root;
    const quality = offers.rungs[rung][0];
    const groupOf = (at: number) => {
      const { loop, segment } = offers.place(at);
      return `${loop}: ${offers.tables.groupOf(segment)}`;
    };
    for (const slot of playout.pending()) {
      const inTime = playout.startS(slot, this.nowS) >= this.nowS + settings.decodeFrameS;
      if (!inTime || groupOf(slot.position) !== groupOf(position)) continue;
      const [shownQuality, level] = offers.rungs[slot.rung ?? 0];
      if (quality < shownQuality && stores.keyframes.shownTiers(position, quality) >= levels[level].tiers) {
        playout.replace(slot, quality * levels.length + level);
      }
    }
  }

  /** Fetch the replacement that gains most for its bytes, if any will be in time; false if there is none. */
  private async *replaceBest(): Events<boolean> {
    const { playout, policy, settings } = this.parts;
    if (!(settings.replace && policy.adapts)) return false;
    const estimateBps = estimateThroughput(this.history());
    const best = estimateBps ? this.bestReplacement(SAFETY * estimateBps) : null;
    if (!best) return false;
    const { slot, rung } = best;
    const { position } = slot;
    const batch = this.replacing(slot, rung);
    const arrival = await this.receive({ kind: "replacement", position, rung, batch, sentS: this.nowS }, null);
    yield { type: "arrived", arrival, throughputBps: estimateBps };
    const late = slot.committed || this.nowS + settings.decodeFrameS > playout.startS(slot, this.nowS);
    if (this.stopped || !isComplete(arrival) || late) return true; // what it replaces stays
    yield { type: "replaced", position, before: slot.rung ?? 0, after: rung };
    playout.replace(slot, rung);
    return true;
  }

  /** The better rung of a buffered segment that gains most dB seconds a byte among those expected in time. */
  private bestReplacement(rateBps: number): { slot: Slot; rung: number } | null {
    const { offers: c, downloader, playout, settings, stores } = this.parts;
    let best: { slot: Slot; rung: number; worth: number } | null = null;
    for (const slot of playout.pending()) {
      const startS = playout.startS(slot, this.nowS);
      if (!(this.nowS < startS && startS < Infinity)) continue;
      const { rungs } = c.of(c.index(slot.position));
      for (const { index: rung, sizeBytes, quality } of stores.keyframes.options(slot.position)) {
        // The deltas are decoded where only the keyframes would be better.
        const size = sizeBytes - (rungs[rung].level === rungs[slot.rung ?? 0].level ? rungs[rung].deltaBytes : 0);
        const gain = quality - (slotQuality(c, slot) ?? 0);
        const worth = (gain * slot.seconds) / Math.max(1, size);
        const comesS = this.nowS + downloader.rttS + (8 * size) / rateBps + settings.decodeFrameS;
        if (gain < REPLACE_GAIN_DB || comesS > startS || (best && worth <= best.worth)) continue;
        if (usable(stores, this.replacing(slot, rung))) best = { slot, rung, worth };
      }
    }
    return best;
  }

  /** The files that it takes to show another rung of a buffered segment: with the same level, only its keyframes. */
  private replacing(slot: Slot, rung: number): Batch {
    const { offers, stores } = this.parts;
    const batch = stores.keyframes.missing(slot.position, rung);
    return offers.rungs[rung][1] === offers.rungs[slot.rung ?? 0][1] ? { ...batch, delta: [] } : batch;
  }

  private *shown(slots: readonly Slot[]): Generator<Shown> {
    const { offers: c, playout } = this.parts;
    for (const slot of slots) {
      const { loop, segment } = c.place(slot.position);
      const psnr = c.measured ? slotQuality(c, slot) : null;
      const startS = playout.startS(slot, this.nowS);
      const { position, rung, readyS, frames, stallS } = slot;
      yield { type: "shown", position, segment, loop, rung, readyS, startS, frames, stallS, psnr };
    }
  }
}

const usable = (stores: Stores, batch: Batch): boolean =>
  !stores.unusable.size || filesOf(batch).every((path) => !stores.unusable.has(path));

const slotQuality = (o: Offers, slot: Slot): number | null =>
  slot.rung === null ? null : o.of(o.index(slot.position)).rungs[slot.rung].psnr;

// A link that replays a trace: airgs_codec/play/trace.py, link.py and SimulatedDownloader, number by number.
import { FormatError, type Reason } from "../../src/format/errors.ts";
import { CHECK_S } from "../../src/generated/constants.ts";
import type { Arrival, Downloader, GiveUp, Request, Partial as UnderWay } from "../../src/play/downloader.ts";
import { filesOf, type Offers } from "../../src/play/offers.ts";
import { Playout, type SessionSettings, sessionSettings } from "../../src/play/playout.ts";

/** Rates that hold from their starts on; after the last second comes the first one. */
export class Trace {
  private readonly totals = [0]; // bits delivered up to each start, and to the end

  constructor(
    readonly startsS: readonly number[],
    readonly ratesBps: readonly number[],
    readonly durationS: number,
  ) {
    ratesBps.forEach((rate, i) => {
      this.totals.push(this.totals[i] + rate * ((startsS[i + 1] ?? durationS) - startsS[i]));
    });
  }

  /** Integral of the rate from 0 on. */
  bitsUntil(atS: number): number {
    const rest = atS % this.durationS;
    const rounds = Math.round((atS - rest) / this.durationS);
    const i = lastUpTo(this.startsS, rest);
    return rounds * this.total + this.totals[i] + this.ratesBps[i] * (rest - this.startsS[i]);
  }

  /** When so many bytes have passed, the first bit at `atS`. */
  arrivalS(bytes: number, atS: number): number {
    const target = this.bitsUntil(atS) + 8 * bytes;
    let rounds = Math.floor(target / this.total);
    let rest = target - rounds * this.total;
    if (rest <= 0 && rounds > 0) {
      rounds--; // done exactly at the end of a round: when its last bit came
      rest = this.total;
    }
    const i = Math.max(0, this.totals.findIndex((total) => total >= rest) - 1);
    const rate = this.ratesBps[i];
    const inside = rate > 0 ? (rest - this.totals[i]) / rate : 0;
    return Math.max(atS, rounds * this.durationS + this.startsS[i] + inside);
  }

  private get total(): number {
    return this.totals[this.totals.length - 1];
  }
}

function lastUpTo(ascending: readonly number[], value: number): number {
  let i = ascending.length - 1;
  while (ascending[i] > value) i--;
  return i;
}

export interface SimulatedLink {
  trace: Trace;
  rttS: number;
  /** Path → why a file cannot be used. */
  faults?: Record<string, Reason>;
}

/** Time is that of the trace; no clock is read. */
export class SimulatedDownloader implements Downloader {
  readonly rttS: number;
  /** What was asked for, in order. */
  readonly requests: Request[] = [];
  protected nowS = 0;
  private readonly faults: Map<string, FormatError>;
  private freeS = 0; // when the last batch was over

  constructor(
    protected readonly link: SimulatedLink,
    protected readonly offers: Offers,
  ) {
    this.rttS = link.rttS;
    const faults = Object.entries(link.faults ?? {});
    this.faults = new Map(faults.map(([path, reason]) => [path, new FormatError(reason, path, "made up")]));
  }

  now(): number {
    return this.nowS;
  }

  async wait(untilS: number): Promise<void> {
    this.nowS = Math.max(this.nowS, untilS);
  }

  async fetch(request: Request, giveUp: GiveUp | null, _signal: AbortSignal): Promise<Arrival> {
    this.requests.push(request);
    const files = filesOf(request.batch);
    const sizes = files.map((path) => this.wireSize(path));
    const expected = sizes.reduce((a, b) => a + b, 0);
    const firstS = Math.max(this.freeS, request.sentS) + this.rttS;
    let [endS, passed] = [this.link.trace.arrivalS(expected, firstS), expected];
    const stopped = giveUp && this.looks(firstS, endS, expected).find(giveUp);
    if (stopped) [endS, passed] = [stopped.atS, stopped.bytes];
    this.freeS = endS;
    this.nowS = endS;
    const came = files.filter((_, i) => sizes.reduce((a, size) => a + Math.min(sizes[i], size), 0) <= passed);
    const refused = came.filter((path) => this.faults.has(path));
    return {
      request,
      firstByteS: firstS,
      atS: endS,
      bytes: Math.max(1, roundHalfEven(passed)),
      whole: came.filter((path) => !this.faults.has(path)),
      refused: new Map(refused.map((path) => [path, this.faults.get(path) as FormatError])),
      abandoned: Boolean(stopped),
      cached: false,
    };
  }

  private looks(firstS: number, endS: number, expectedBytes: number): UnderWay[] {
    const looks: UnderWay[] = [];
    for (let look = 1; firstS + CHECK_S * look < endS; look++) {
      const atS = firstS + CHECK_S * look;
      const { trace } = this.link;
      const bytes = Math.max(0, trace.bitsUntil(atS) - trace.bitsUntil(firstS)) / 8;
      looks.push({ atS, elapsedS: atS - firstS, bytes, expectedBytes });
    }
    return looks;
  }

  /** Bytes of a file with its headers; of a missing one the headers alone. */
  private wireSize(path: string): number {
    const missing = this.faults.get(path)?.reason === "missing_file";
    return missing ? this.offers.headerBytes : this.offers.wire([path]);
  }
}

/** The nearest whole number, of two the even one: as Python rounds. */
function roundHalfEven(value: number): number {
  const whole = Math.round(value);
  return whole - value === 0.5 && whole % 2 ? whole - 1 : whole;
}

/** As in airgs_codec/play/offers.py. */
const SESSION_S = 30;

/** The rules of a session, and how often it plays the sequence; null: for about SESSION_S. */
export interface Rules extends SessionSettings {
  loops: number | null;
}

export const rulesOf = (given: Partial<Rules> = {}): Rules => ({
  ...sessionSettings(given),
  loops: given.loops ?? null,
});

/** How often a session plays the sequence: as wanted, else for about SESSION_S; once while it grows. */
export function loopsOf({ live, durationS }: Offers, wanted: number | null): number {
  if (live) return 1;
  return wanted ?? Math.max(1, roundHalfEven(SESSION_S / durationS));
}

/** The timeline of a session that plays the sequence as often as its settings say. */
export const playoutOf = (offers: Offers, settings: Rules): Playout =>
  new Playout(offers, settings, offers.end(loopsOf(offers, settings.loops)));

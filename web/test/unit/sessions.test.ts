// Sessions over simulated links happen as those of airgs_codec.play.
import assert from "node:assert/strict";
import { test } from "node:test";
import type { Reason } from "../../src/format/errors.ts";
import { ROOT_PATH } from "../../src/generated/constants.ts";
import type { GiveUp, Request, SessionEvent } from "../../src/play/downloader.ts";
import { Offers } from "../../src/play/offers.ts";
import { Session } from "../../src/play/session.ts";
import { Stores } from "../../src/play/stores.ts";
import { playoutOf, rulesOf, SimulatedDownloader, Trace } from "../support/link.ts";
import { NumberTables, type PackageNumbers } from "../support/offers.ts";
import { makePolicy } from "../support/policies.ts";
import { readVectors } from "./files.ts";

type Row = (string | number)[];

interface Play {
  package: number;
  trace: number;
  policy: string;
  rtt_s: number;
  settings: Record<string, number | boolean>;
  faults: Record<string, Reason>;
  growth: number[];
  events: Row[];
}

interface TraceNumbers {
  starts_s: number[];
  rates_bps: number[];
  duration_s: number;
}

const { packages, traces, sessions } = readVectors("sessions") as {
  packages: PackageNumbers[];
  traces: TraceNumbers[];
  sessions: Play[];
};

const camel = (name: string) => name.replace(/_(.)/g, (_, letter: string) => letter.toUpperCase());

/** A link over a package to which groups are added whenever airgs.json is read again. */
class GrowingDownloader extends SimulatedDownloader {
  private reads = 0;
  growth: number[] = [];

  override fetch(request: Request, giveUp: GiveUp | null, signal: AbortSignal) {
    if (request.batch.tables[0] === ROOT_PATH) {
      const count = this.growth[this.reads];
      const live = this.reads < this.growth.length - 1;
      if (this.reads++ && count) (this.offers.tables as NumberTables).grow(count, live);
    }
    return super.fetch(request, giveUp, signal);
  }
}

async function played(play: Play): Promise<Row[]> {
  const { starts_s, rates_bps, duration_s } = traces[play.trace];
  const numbers = packages[play.package];
  const tables = new NumberTables(numbers, play.growth[0], play.growth.length > 0);
  const offers = new Offers(tables, numbers.header_bytes);
  if (play.growth.length) offers.first = tables.index.entry(tables.index.groups - 1).firstSegment;
  const given = Object.fromEntries(Object.entries(play.settings).map(([name, value]) => [camel(name), value]));
  const settings = rulesOf(given);
  const { faults, rtt_s: rttS } = play;
  const trace = new Trace(starts_s, rates_bps, duration_s);
  const downloader = new GrowingDownloader({ trace, rttS, faults }, offers);
  downloader.growth = play.growth;
  const policy = makePolicy(play.policy, offers);
  const playout = playoutOf(offers, settings);
  const stores = new Stores(offers);
  const rows: Row[] = [];
  const parts = { offers, downloader, policy, settings, playout, stores };
  for await (const event of new Session(parts, new AbortController().signal).run()) rows.push(row(event));
  return rows;
}

/** An event as the vectors have it. */
function row(event: SessionEvent): Row {
  if (event.type === "arrived") {
    const { request, bytes, firstByteS, atS, abandoned, whole, refused } = event.arrival;
    const { kind, position, rung, sentS } = request;
    return [kind, position, rung, bytes, sentS, firstByteS, atS, Number(abandoned), whole.length, refused.size];
  }
  if (event.type === "replaced") return [event.type, event.position, event.before, event.after];
  if (event.type === "lost") return [event.type, event.position, event.atS];
  if (event.type === "cut") return [event.type, event.atS];
  const { type, segment, loop, rung, frames, readyS, startS, stallS } = event;
  return [type, segment, loop, rung ?? -1, frames, readyS, startS, stallS];
}

/** Whether two numbers are one, or two times that differ by their last digits. */
function same(got: string | number, expected: string | number): boolean {
  if (typeof got === "string" || typeof expected === "string" || Number.isInteger(got)) return got === expected;
  return Math.abs(got - expected) <= 1e-9 * Math.max(1, Math.abs(expected));
}

sessions.forEach((play, number) => {
  test(`session ${number}: ${packages[play.package].name}, ${play.policy}`, async () => {
    const rows = await played(play);
    rows.forEach((found, i) => {
      const expected = play.events[i] ?? [];
      const equal = found.length === expected.length && found.every((part, k) => same(part, expected[k]));
      assert.ok(equal, `event ${i}: expected ${JSON.stringify(expected)}, got ${JSON.stringify(found)}`);
    });
    assert.equal(rows.length, play.events.length);
  });
});

test("the sessions hold what is rare", () => {
  const rows = sessions.flatMap((play) => play.events);
  const count = (kind: string) => rows.filter((one) => one[0] === kind).length;
  for (const kind of ["replacement", "replaced", "lost", "cut"]) assert.ok(count(kind) > 0, kind);
  assert.ok(
    rows.some((one) => one[7] === 1 && (one[0] === "group" || one[0] === "state")),
    "abandoned",
  );
  assert.ok(
    rows.some((one) => one[0] === "tables" && one[4] !== 0),
    "tables between batches",
  );
});

test("airgs.json that came before it was asked for says nothing of the link", async () => {
  class Opened extends SimulatedDownloader {
    override async fetch(request: Request, giveUp: GiveUp | null, signal: AbortSignal) {
      const arrival = await super.fetch(request, giveUp, signal);
      return request.batch.tables[0] === ROOT_PATH ? { ...arrival, atS: request.sentS - 1 } : arrival;
    }
  }
  const offers = new Offers(new NumberTables(packages[0]));
  const stores = new Stores(offers);
  const parts = { offers, settings: rulesOf({}), policy: makePolicy("robust-mpc", offers), stores };
  const trace = new Trace([0], [1e6], 1000);
  const downloader = new Opened({ trace, rttS: 0.05, faults: {} }, offers);
  const session = new Session(
    { ...parts, downloader, playout: playoutOf(offers, parts.settings) },
    new AbortController().signal,
  );
  for await (const event of session.run()) if (event.type === "shown") break;
  assert.ok((8 * stores.first.bytes) / stores.first.seconds <= 1e6);
});

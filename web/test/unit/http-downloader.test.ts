// Batches over a connection: what is measured, given up and kept.
import assert from "node:assert/strict";
import { mock, test } from "node:test";
import { FormatError } from "../../src/format/errors.ts";
import type { Fetched, FetchOptions } from "../../src/media/client.ts";
import type { Partial, Request } from "../../src/play/downloader.ts";
import { HttpDownloader, joinNewest, type Source } from "../../src/play/downloader.ts";
import { missing, NONE, Offers } from "../../src/play/offers.ts";
import { Session } from "../../src/play/session.ts";
import { Stores } from "../../src/play/stores.ts";
import { playoutOf, rulesOf } from "../support/link.ts";
import { NumberTables, type PackageNumbers } from "../support/offers.ts";
import { makePolicy } from "../support/policies.ts";
import { readVectors } from "./files.ts";

const { packages } = readVectors("sessions") as { packages: PackageNumbers[] };
const never = new AbortController().signal;
const nowS = () => performance.now() / 1000;

const nothing = (): Fetched => {
  return { firstByteS: nowS(), endS: nowS(), bytes: 0, cached: false, whole: [], refused: new Map() };
};

/** Answers as the test tells it to; where a fetch is given up, with the first file alone. */
class Fake implements Source {
  opened: Fetched = { ...nothing(), bytes: 3000, whole: ["airgs.json"] };
  fetched: string[][] = [];
  answer: Fetched | null = null;
  progress: FetchOptions["onProgress"];

  fetch(paths: string[], { signal, onProgress }: FetchOptions = {}) {
    this.fetched.push(paths);
    this.progress = onProgress;
    if (this.answer) return Promise.resolve(this.answer);
    return new Promise<Fetched>((resolve) => {
      const end = () => resolve({ ...nothing(), bytes: 900, whole: paths.slice(0, 1) });
      if (signal?.aborted) end();
      else signal?.addEventListener("abort", end);
    });
  }

  refreshRoot(): Promise<Fetched> {
    return Promise.reject(new FormatError("bad_value", "airgs.json", "another package"));
  }
}

function made() {
  const offers = new Offers(new NumberTables(packages[0]));
  const source = new Fake();
  return { offers, source, downloader: new HttpDownloader(source) };
}

function request(offers: Offers, tables: string[] = []): Request {
  const batch = tables.length ? { keyframes: [], delta: [], tables } : missing(offers.of(0), 0, NONE);
  return { kind: tables.length ? "tables" : "group", position: 0, rung: 0, batch, sentS: 0 };
}

test("airgs.json was fetched when the package was opened; later another package is refused", async () => {
  const { offers, downloader } = made();
  const asked = request(offers, ["airgs.json"]);
  const first = await downloader.fetch(asked, null, never);
  assert.deepEqual([first.whole, first.bytes], [["airgs.json"], 3000]);
  const second = await downloader.fetch(asked, null, never);
  assert.deepEqual([[...second.refused.keys()], second.whole], [["airgs.json"], []]);
});

test("the round trip is the shortest wait that no cache has shortened", async () => {
  const { offers, downloader, source } = made();
  assert.equal(downloader.rttS, 0);
  const whole = [...missing(offers.of(0), 0, NONE).keyframes];
  for (const [waitS, cached, expected] of [
    [5, false, 5],
    [1, true, 5],
    [2, false, 2],
    [3, false, 2],
  ] as const) {
    source.answer = { ...nothing(), firstByteS: nowS() + waitS, endS: nowS() + 9, bytes: 1000, cached, whole };
    const { cached: told } = await downloader.fetch(request(offers), null, never);
    assert.equal(told, cached);
    assert.ok(Math.abs(downloader.rttS - expected) < 0.5);
  }
});

test("a download is looked at from its first byte on; what is whole when it is given up is kept", async () => {
  mock.timers.enable({ apis: ["setInterval"] });
  const { offers, downloader, source } = made();
  const asked = request(offers);
  const looks: Partial[] = [];
  const coming = downloader.fetch(asked, (partial) => looks.push(partial) > 1, never);
  mock.timers.tick(5000);
  assert.equal(looks.length, 0);
  source.progress?.(400, 1200);
  mock.timers.tick(500);
  source.progress?.(900, 1200);
  mock.timers.tick(500);
  const arrival = await coming;
  mock.timers.reset();
  assert.deepEqual(
    looks.map(({ bytes }) => bytes),
    [400, 900],
  );
  assert.equal(looks[0].expectedBytes, 1200);
  assert.deepEqual([arrival.abandoned, arrival.whole], [true, asked.batch.keyframes.slice(0, 1)]);
});

test("a session that is stopped ends its download", async () => {
  const { offers, downloader } = made();
  const stop = new AbortController();
  const coming = downloader.fetch(request(offers), null, stop.signal);
  stop.abort();
  assert.equal((await coming).abandoned, true);
});

test("waits end when the playout changes, or the session is stopped", async () => {
  const { offers, downloader } = made();
  const playout = playoutOf(offers, rulesOf());
  const stop = new AbortController();
  const paused = downloader.wait(Infinity, playout, stop.signal);
  playout.hold(nowS(), "pause", true);
  await paused;
  const stopped = downloader.wait(Infinity, playout, stop.signal);
  stop.abort();
  await stopped;
  await downloader.wait(nowS() - 1, playout, never);
});

test("a session over a connection plays to the end", async () => {
  const { offers, downloader, source } = made();
  source.fetch = async (paths) => ({ ...nothing(), bytes: 1000, whole: [...paths].reverse() });
  const settings = rulesOf({ bufferS: 1000, loops: 2 });
  const playout = playoutOf(offers, settings);
  const stores = new Stores(offers);
  const policy = makePolicy("robust-mpc", offers);
  const parts = { offers, downloader, policy, settings, playout, stores };
  const kinds = new Set<string>();
  for await (const event of new Session(parts, never).run()) kinds.add(event.type);
  assert.deepEqual([...kinds], ["arrived", "shown"]);
  assert.equal(playout.slots.length, 2 * offers.segments);
  assert.ok(playout.slots.every((slot) => slot.rung !== null && slot.startAt < Infinity));
});

test("a growing package is joined at its newest group", async () => {
  const source = new Fake();
  const tables = new NumberTables(packages[2], 66, true);
  const offers = new Offers(tables);
  await joinNewest(offers, source);
  assert.deepEqual([offers.first, source.fetched], [65, []]);
  tables.grow(64, true); // the newest stands on a page
  const { index } = tables;
  index.hasPage = () => false;
  source.answer = { ...nothing(), whole: ["index/1/1.json"] };
  await joinNewest(offers, source);
  assert.deepEqual([offers.first, source.fetched], [63, [["index/1/1.json"]]]);
});

// What a viewer does to a session: seeks, pauses, other policies; and what a browser does: caches.
import assert from "node:assert/strict";
import { test } from "node:test";
import type { GiveUp, Request, SessionEvent } from "../../src/play/downloader.ts";
import { Offers } from "../../src/play/offers.ts";
import type { Playout } from "../../src/play/playout.ts";
import { sessionSettings } from "../../src/play/playout.ts";
import { Session } from "../../src/play/session.ts";
import { Stores } from "../../src/play/stores.ts";
import { playoutOf, rulesOf, SimulatedDownloader, Trace } from "../support/link.ts";
import { NumberTables, type PackageNumbers } from "../support/offers.ts";
import { makePolicy } from "../support/policies.ts";
import { readVectors } from "./files.ts";

const { packages } = readVectors("sessions") as { packages: PackageNumbers[] };
const DRAWN = packages[0]; // three groups of five segments
const FAST = new Trace([0], [1e9], 3600);
/** Slow at first, then fast: what is buffered by then is worth replacing. */
const RISING = new Trace([0, 5], [3e5, 1e9], 3600);
const KEYFRAMES = /^keyframe/;

class Watched extends SimulatedDownloader {
  cached = false;
  /** What a viewer does while the session waits. */
  during: ((untilS: number, playout: Playout) => number) | null = null;
  /** Looks at a request before it is sent. */
  before: ((request: Request, giveUp: GiveUp | null) => void) | null = null;

  override async wait(untilS: number, playout?: Playout): Promise<void> {
    const act = this.during;
    await super.wait(act && playout ? act(untilS, playout) : untilS);
  }

  override async fetch(request: Request, giveUp: GiveUp | null, signal: AbortSignal) {
    this.before?.(request, giveUp);
    return { ...(await super.fetch(request, giveUp, signal)), cached: this.cached };
  }

  /** Paths of the batches of a kind. */
  paths(kind?: string): string[] {
    const wanted = this.requests.filter((request) => !kind || request.kind === kind);
    return wanted.flatMap(({ batch }) => [...batch.keyframes, ...batch.delta, ...batch.tables]);
  }
}

class Viewer {
  readonly offers = new Offers(new NumberTables(DRAWN));
  readonly settings;
  readonly playout: Playout;
  readonly stores = new Stores(this.offers);
  readonly downloader: Watched;

  constructor(settings = {}, trace = FAST) {
    this.settings = rulesOf({ loops: 1, startupS: 0, ...settings });
    this.playout = playoutOf(this.offers, this.settings);
    this.downloader = new Watched({ trace, rttS: 0.05 }, this.offers);
  }

  /** The events of a session from a position until one is the last. */
  async watch(policy: string, from: number, isLast: (event: SessionEvent) => boolean = () => false) {
    const parts = { ...this, policy: makePolicy(policy, this.offers) };
    const stop = new AbortController();
    const events: SessionEvent[] = [];
    for await (const event of new Session(parts, stop.signal, from).run()) {
      events.push(event);
      if (isLast(event)) stop.abort();
    }
    return events;
  }
}

const enqueued = (position: number) => (event: SessionEvent) =>
  event.type === "arrived" && event.arrival.request.position === position && event.arrival.request.kind !== "tables";

test("a seek goes on with the tables and keyframes that are there", async () => {
  const viewer = new Viewer();
  await viewer.watch("fixed:0", 0, enqueued(6));
  assert.equal(viewer.playout.last?.position, 5); // what came when it was stopped is not shown
  const [before, read] = [viewer.downloader.requests.length, viewer.stores.downloads.length];
  viewer.playout.restart(0.25);
  await viewer.watch("fixed:0", 8);
  assert.equal(viewer.playout.slots[0].position, 8);
  assert.equal(viewer.playout.last?.position, 14);
  const later = viewer.downloader.requests.slice(before);
  assert.equal(later[0].kind, "delta"); // the second group was begun: its table and keyframes are there
  assert.ok(!later.some(({ batch }) => batch.tables.includes("airgs.json")));
  assert.ok(viewer.stores.downloads.length > read);
});

test("another policy takes over from what is committed", async () => {
  const viewer = new Viewer({ bufferS: 60 });
  await viewer.watch("fixed:3", 0, enqueued(10));
  viewer.playout.commit(2);
  const free = viewer.playout.firstFree(viewer.downloader.now());
  assert.equal(free, 3);
  viewer.playout.truncate(3);
  await viewer.watch("fixed:0", 3);
  const rungs = viewer.playout.slots.map((slot) => slot.rung);
  assert.deepEqual(rungs, [3, 3, 3, ...new Array(12).fill(0)]);
  assert.equal(viewer.playout.stalls, 0);
});

test("a pause while the buffer is full ends the wait, and shifts the rest", async () => {
  const viewer = new Viewer({ bufferS: 3 });
  const waits: number[] = [];
  viewer.downloader.during = (untilS, playout) => {
    waits.push(untilS);
    const nowS = viewer.downloader.now();
    if (waits.length === 1) {
      playout.hold(nowS, "pause", true);
      return nowS;
    }
    if (waits.length > 2) return untilS;
    assert.equal(untilS, Infinity);
    playout.hold(nowS + 100, "pause", false);
    return nowS + 100;
  };
  const events = await viewer.watch("fixed:0", 0);
  const starts = events.flatMap((event) => (event.type === "shown" ? [event.startS] : []));
  assert.ok(starts.at(-1)! > 100 && starts.length === 15);
  assert.equal(viewer.playout.stalls, 0);
});

test("a pause puts off when a download is given up", async () => {
  const viewer = new Viewer({ replace: false });
  const { playout, downloader } = viewer;
  const answers: boolean[] = [];
  downloader.before = ({ position, kind }, giveUp) => {
    if (position !== 5 || kind === "tables" || !giveUp) return;
    const deadlineS = playout.deadlineS(playout.dueAt(downloader.now()), downloader.now());
    // Two seconds are left of it, a second before its deadline.
    const partial = { atS: deadlineS - 1, elapsedS: 10, bytes: 1e9, expectedBytes: 1.2e9 };
    answers.push(giveUp(partial));
    playout.hold(downloader.now(), "pause", true);
    answers.push(giveUp(partial));
  };
  await viewer.watch("throughput", 0, enqueued(5));
  assert.deepEqual(answers, [true, false]);
});

test("what a browser had in its cache says nothing of the link", async () => {
  const viewer = new Viewer();
  viewer.downloader.cached = true;
  const events = await viewer.watch("paper", 0);
  assert.equal(viewer.stores.downloads.length, 0);
  const estimates = events.flatMap((event) => (event.type === "arrived" ? [event.throughputBps] : []));
  assert.deepEqual(new Set(estimates), new Set([0]));
});

test("what is committed is not replaced", async () => {
  for (const committed of [false, true]) {
    const viewer = new Viewer({ bufferS: 6, abandon: false }, RISING);
    if (committed) {
      viewer.playout.onChange(() => {
        for (const slot of viewer.playout.slots) viewer.playout.commit(slot.position);
      });
    }
    const events = await viewer.watch("paper", 0);
    assert.equal(
      events.some((event) => event.type === "replaced"),
      !committed,
    );
  }
});

test("an endless session plays loop after loop, its tables fetched once", async () => {
  const viewer = new Viewer({ loops: Infinity });
  assert.equal(viewer.playout.end, Infinity);
  await viewer.watch("robust-mpc", 0, enqueued(100));
  assert.ok(viewer.playout.last?.position === 99);
  const tables = viewer.downloader.paths().filter((path) => path.startsWith("group/"));
  assert.deepEqual(tables.sort(), ["group/1.json.gz", "group/2.json.gz", "group/3.json.gz"]);
  const keyframes = viewer.downloader.paths().filter((path) => KEYFRAMES.test(path));
  assert.ok(keyframes.length > new Set(keyframes).size);
});

test("the end can be moved while it plays", async () => {
  const viewer = new Viewer();
  await viewer.watch("fixed:0", 0, (event) => {
    viewer.playout.end = 20;
    return event.type === "lost";
  });
  assert.equal(viewer.playout.last?.position, 19);
});

test("without measured quality only fixed rungs can be played", () => {
  const viewer = new Viewer();
  (viewer.offers.tables.root as { views: object }).views = { reference: "none" };
  const { signal } = new AbortController();
  assert.throws(() => new Session({ ...viewer, policy: makePolicy("paper", viewer.offers) }, signal), /measured/);
  assert.ok(new Session({ ...viewer, policy: makePolicy("fixed:0", viewer.offers) }, signal));
});

test("settings that cannot work", () => {
  for (const [settings, words] of [
    [{ bufferS: 0 }, /buffer/],
    [{ bufferS: Number.NaN }, /buffer/],
  ] as const) {
    assert.throws(() => sessionSettings(settings), words);
  }
});

// Where frames are dropped, coarser levels are offered; finer ones are tried again, seldom enough.
import assert from "node:assert/strict";
import { test } from "node:test";
import { Offers } from "../../src/play/offers.ts";
import { type Cause, DropRule } from "../../src/play/policies/drops.ts";
import { RungTotals } from "../../src/play/rungs.ts";
import { Session } from "../../src/play/session.ts";
import { Stores } from "../../src/play/stores.ts";
import { playoutOf, rulesOf, SimulatedDownloader, Trace } from "../support/link.ts";
import { NumberTables, type PackageNumbers } from "../support/offers.ts";
import { ADAPTIVE, makePolicy } from "../support/policies.ts";
import { readVectors } from "./files.ts";

const FPS = 24;
const TIERS = [3, 3, 2, 1];

/** A viewer whose device drops a share of the frames of each level. */
class Device {
  readonly rule = new DropRule(TIERS);
  /** Moments of changes, seconds of play, and the finest level from then on. */
  readonly changes: [number, number][] = [];
  nowS = 0;

  constructor(
    readonly shares: number[],
    readonly cause: Cause = "display",
  ) {}

  /** Plays the finest level that is offered, or a coarser one. */
  run(seconds: number, { rate = FPS, level = 0 } = {}): this {
    const endS = this.nowS + seconds;
    let owed = 0;
    while (this.nowS < endS) {
      const shown = Math.max(level, this.rule.finest);
      const share = this.shares[shown];
      owed += share / (1 - share);
      const count = Math.floor(owed);
      owed -= count;
      this.nowS += (1 + count) / rate;
      const dropped = { decoder: 0, display: 0, [this.cause]: count };
      if (this.rule.add({ level: shown, rate, dropped })) this.changes.push([this.nowS, this.rule.finest]);
    }
    return this;
  }

  get levels(): number[] {
    return this.changes.map(([, level]) => level);
  }
}

test("a device that keeps up is left alone, also with a dropped frame now and then", () => {
  assert.deepEqual(new Device([0.1, 0, 0, 0]).run(600).levels, []);
});

test("where drawing is slow fewer Gaussians are offered, where decoding is the next level, each after a window", () => {
  const drawing = new Device([0.6, 0.6, 0.4, 0.05]).run(20);
  assert.deepEqual([drawing.levels, drawing.rule.cause], [[2, 3], "display"]);
  assert.ok(drawing.changes[0][0] >= 5);
  const decoding = new Device([0.6, 0.5, 0.4, 0.3], "decoder").run(60);
  assert.deepEqual([decoding.levels, decoding.rule.cause], [[1, 2, 3], "decoder"]);
});

test("what was dropped of a coarser level than the finest one lowers that", () => {
  assert.deepEqual(new Device([0, 0, 0.4, 0]).run(8, { level: 2 }).levels, [3]);
});

test("finer levels come back when the device has been fast for a while, and then stay", () => {
  const device = new Device([0.5, 0.5, 0, 0]).run(10);
  device.shares.fill(0);
  device.run(300);
  assert.deepEqual([device.levels, device.rule.cause], [[2, 1, 0], null]);
  const [lowered, first, second] = device.changes.map(([atS]) => atS);
  assert.ok(first - lowered > 25 && second - first > 25);
});

test("a level that is too much is tried ever less often", () => {
  const device = new Device([0.5, 0.5, 0, 0]).run(3600);
  const tries = device.changes.filter(([, level]) => level === 1).map(([atS]) => atS);
  const between = tries.slice(1).map((atS, i) => atS - tries[i]);
  assert.deepEqual(device.levels.slice(0, 5), [2, 1, 2, 1, 2]);
  for (let i = 1; i < between.length - 1; i++) assert.ok(between[i] > 1.5 * between[i - 1] || between[i] > 480);
  assert.ok(tries.length < 14);
});

test("play at a coarser level proves nothing of a finer one", () => {
  const device = new Device([0.5, 0.5, 0, 0]).run(10);
  while (device.rule.finest > 1) device.run(1);
  device.run(600, { level: 3 });
  assert.equal(device.rule.finest, 1);
});

test("frames that no display has time for, and one long sleep, change nothing", () => {
  const fast = new Device([0.5, 0, 0, 0]).run(60, { rate: 120 }); // of 120 pictures a second 60 are shown
  const rule = new DropRule(TIERS);
  const gaps = Array.from({ length: 1000 }, (_, frame) => (frame === 150 ? 1e6 : 0));
  assert.ok(!gaps.some((display) => rule.add({ level: 0, rate: FPS, dropped: { decoder: 0, display } })));
  assert.deepEqual(fast.levels, []);
});

test("while the size of pictures changes nothing is judged", () => {
  const device = new Device([0.6, 0.6, 0.6, 0.6]);
  for (let change = 0; change < 20; change++) {
    device.run(4).rule.restart();
  }
  assert.deepEqual(device.levels, []);
  assert.deepEqual(device.run(6).levels, [2]);
});

const { packages } = readVectors("sessions") as { packages: PackageNumbers[] };
const DRAWN = packages[0];

test("no policy chooses a level that is not offered, though a link has room for it", async () => {
  const levels = DRAWN.levels.length;
  for (const name of ["fixed:0", ...ADAPTIVE.keys()]) {
    const offers = new Offers(new NumberTables(DRAWN));
    const settings = rulesOf({ loops: 1, startupS: 0 });
    const downloader = new SimulatedDownloader({ trace: new Trace([0], [1e9], 3600), rttS: 0.05 }, offers);
    const parts = { offers, settings, downloader, playout: playoutOf(offers, settings) };
    const session = new Session(
      { ...parts, stores: new Stores(offers), policy: makePolicy(name, offers) },
      new AbortController().signal,
    );
    const shown: number[] = [];
    for await (const event of session.run()) {
      if (event.type === "arrived" && event.arrival.request.position === 4) offers.finest = 1;
      if (event.type === "shown") shown.push(event.rung! % levels);
    }
    assert.ok(
      shown.slice(5).every((level) => level >= 1),
      `${name}: ${shown}`,
    );
    if (name === "fixed:0") assert.deepEqual(new Set(shown.slice(5)), new Set([1]));
  }
});

test("what is not offered can still be chosen", () => {
  const offers = new Offers(new NumberTables(DRAWN));
  offers.finest = 1;
  const held = new RungTotals(offers).read();
  offers.finest = 0;
  assert.deepEqual(held, new RungTotals(offers).read());
});

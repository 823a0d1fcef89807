// A budget of Gaussians: rungs that show more are neither fetched nor shown.
import assert from "node:assert/strict";
import { test } from "node:test";
import { ConfigError, NONE, Offers, optionsOf } from "../../src/play/offers.ts";
import { RungTotals } from "../../src/play/rungs.ts";
import { Session } from "../../src/play/session.ts";
import { Stores } from "../../src/play/stores.ts";
import { playoutOf, rulesOf, SimulatedDownloader, Trace } from "../support/link.ts";
import { NumberTables } from "../support/offers.ts";
import { makePolicy } from "../support/policies.ts";

/** Two groups of two tiers; L0 needs both, L1 the first. */
const tables = () =>
  new NumberTables({
    ...{ name: "", frame_rate: [10, 1], header_bytes: 0, root_bytes: 1, page_bytes: 0, qualities: ["Q0", "Q1"] },
    levels: [0, 1].map((j) => ({ id: `L${j}`, tiers: 2 - j, pruned: j / 2 })),
    groups: [
      [10, 30],
      [20, 60],
    ].map((rows) => ({
      // biome-ignore format: by group
      rows,
      table: 10,
      sidecars: [100, 200],
      pictures: [[1000, 300], [2000, 600]], // biome-ignore format: by tier
      segments: [{ frames: 10, bytes: [7, 3], psnr: [[40, 38], [36, 35]] }], // biome-ignore format: by level
    })),
  });

async function levels(budget: number, name: string): Promise<(number | null)[]> {
  const offers = new Offers(tables(), 0, budget);
  const settings = rulesOf({ loops: 2, startupS: 0 });
  const downloader = new SimulatedDownloader({ trace: new Trace([0], [1e9], 3600), rttS: 0.05 }, offers);
  const parts = { offers, settings, downloader, playout: playoutOf(offers, settings) };
  const made = { ...parts, stores: new Stores(offers), policy: makePolicy(name, offers) };
  const shown: (number | null)[] = [];
  for await (const event of new Session(made, new AbortController().signal).run()) {
    if (event.type === "arrived" && event.arrival.request.batch.keyframes.length) {
      const { position, rung } = event.arrival.request;
      assert.ok(offers.of(offers.index(position)).rungs[rung].gaussians <= budget);
    }
    if (event.type === "shown") shown.push(event.rung === null ? null : offers.rungs[event.rung][1]);
  }
  return shown;
}

test("no policy shows more Gaussians than the budget has", async () => {
  for (const name of ["fixed:0", "throughput", "bola", "paper", "paper-literal", "robust-mpc"]) {
    assert.deepEqual(await levels(20, name), [1, 1, 1, 1], name);
    const between = await levels(79, name); // the second group's second tier is too much
    assert.deepEqual([between[1], between[3]], [1, 1], name);
    assert.ok(between.includes(0), name);
  }
  assert.deepEqual(await levels(80, "fixed:0"), [0, 0, 0, 0]);
});

test("a first segment without a rung is refused, a later one is lost", async () => {
  assert.deepEqual(await levels(19, "fixed:0"), [1, null, 1, null]);
  const expected = new ConfigError("budget: expected 10 Gaussians or more, got 9");
  await assert.rejects(levels(9, "robust-mpc"), expected);
});

test("what the budget forbids is no choice, and beats none", () => {
  const offers = new Offers(tables(), 0, 79);
  assert.deepEqual([0, 1].map((s) => optionsOf(offers.of(s), NONE).length), [4, 2]); // biome-ignore format: short
  const onLadder = (budget: number) => new RungTotals(new Offers(tables(), 0, budget)).read().map((r) => r.onLadder);
  assert.deepEqual(onLadder(80), [true, true, true, true]);
  assert.deepEqual(onLadder(79), [false, true, false, true]);
});

// What the tables of a package offer are the numbers that Python found in them.
import assert from "node:assert/strict";
import { test } from "node:test";
import { Tables } from "../../src/format/package.ts";
import { groupPath } from "../../src/format/paths.ts";
import { missing, NONE, Offers, optionsOf, type RungOffer } from "../../src/play/offers.ts";
import { RungTotals } from "../../src/play/rungs.ts";
import { loopsOf } from "../support/link.ts";
import { NumberTables, type PackageNumbers } from "../support/offers.ts";
import { readBytes, readVectors } from "./files.ts";

const { packages } = readVectors("sessions") as { packages: PackageNumbers[] };
const FOX = packages.find(({ name }) => name === "fox")!;
const GOLDEN = "tests/golden/fox";

async function fox(groups: number): Promise<Offers> {
  const tables = Tables.parse(readBytes(`${GOLDEN}/airgs.json`));
  for (let n = 1; n <= groups; n++) await tables.add(groupPath(n), readBytes(`${GOLDEN}/${groupPath(n)}`));
  return new Offers(tables);
}

/** Tables count Gaussians, those numbers do not. */
const offered = ({ gaussians, allowed, ...rung }: RungOffer) => rung;

test("tables and numbers offer the same", async () => {
  const [real, numbers] = [await fox(2), new Offers(new NumberTables(FOX))];
  assert.deepEqual(real.names, numbers.names);
  assert.equal(real.durationS, numbers.durationS);
  assert.equal(real.wire(["airgs.json"]), numbers.wire(["airgs.json"]));
  for (let s = 0; s < real.segments; s++) {
    assert.deepEqual(real.span(s).stop, numbers.span(s).stop);
    assert.deepEqual(real.of(s).rungs.map(offered), numbers.of(s).rungs.map(offered));
    for (const decoded of [NONE, new Set([0]), new Set([2, 3]), new Set([1])]) {
      assert.deepEqual(optionsOf(real.of(s), decoded), optionsOf(numbers.of(s), decoded));
      assert.deepEqual(missing(real.of(s), 1, decoded), missing(numbers.of(s), 1, decoded));
    }
  }
});

test("the offer of a segment is made once, and nobody changes it", async () => {
  const offers = await fox(2);
  const offer = offers.of(0);
  assert.equal(offers.of(0), offer);
  assert.throws(() => Object.assign(offer, { seconds: 0 }), TypeError);
});

test("before its table is there a group can be guessed at, and no further", async () => {
  const c = await fox(1);
  assert.deepEqual([c.knows(0), c.knows(1)], [true, false]);
  assert.deepEqual(c.span(1), { start: 2, stop: 4 });
  assert.equal(c.upcoming(0, 5).length, 1);
  assert.throws(() => c.of(1), /group\/2.json.gz/);
});

test("positions, loops and groups", async () => {
  const c = await fox(2);
  assert.deepEqual(c.place(5), { loop: 2, segment: 1 });
  assert.deepEqual([c.end(3), c.end(Infinity)], [6, Infinity]);
  assert.equal(loopsOf(c, null), 180); // of a sixth of a second
  c.first = 1;
  assert.deepEqual([c.place(0), c.end(3)], [{ loop: 0, segment: 1 }, 5]);
});

test("rungs as people see them", async () => {
  const segment = {
    frames: 10,
    bytes: [1000, 500],
    psnr: [
      [40, 36],
      [30, 35],
    ],
  };
  const group = { table: 100, sidecars: [100], pictures: [[800, 300]], segments: [segment, segment] };
  const levels = [0, 1].map((j) => ({ id: `L${j}`, tiers: 1, pruned: j / 2 }));
  const numbers = { name: "", frame_rate: [10, 1], header_bytes: 0, root_bytes: 0, page_bytes: 0, levels };
  const c = new Offers(new NumberTables({ ...numbers, qualities: ["Q0", "Q1"], groups: [group] }), 0);
  assert.deepEqual(new RungTotals(c).read(), [
    { name: "Q0+L0", psnr: 40, kbps: 12, onLadder: true },
    { name: "Q0+L1", psnr: 30, kbps: 8, onLadder: false },
    { name: "Q1+L0", psnr: 36, kbps: 10, onLadder: true },
    { name: "Q1+L1", psnr: 35, kbps: 6, onLadder: true },
  ]);
  assert.ok(new RungTotals(await fox(1)).read()[0].kbps > 0);
  assert.deepEqual(new RungTotals(await fox(0)).read()[0], { name: "Q0+L0", psnr: null, kbps: 0, onLadder: true });
});

// What the tables of a package offer are the numbers that Python found in them.
import assert from "node:assert/strict";
import { test } from "node:test";
import { Tables } from "../../src/format/package.ts";
import { groupPath } from "../../src/format/paths.ts";
import { Catalogue, NONE } from "../../src/play/catalogue.ts";
import { RungTotals } from "../../src/play/rungs.ts";
import { NumberOffers, type PackageNumbers } from "../support/offers.ts";
import { readBytes, readVectors } from "./files.ts";

const { packages } = readVectors("sessions") as { packages: PackageNumbers[] };
const FOX = packages.find(({ name }) => name === "fox")!;
const GOLDEN = "tests/golden/fox";

async function fox(groups: number): Promise<Catalogue> {
  const tables = Tables.parse(readBytes(`${GOLDEN}/airgs.json`));
  for (let n = 1; n <= groups; n++) await tables.add(groupPath(n), readBytes(`${GOLDEN}/${groupPath(n)}`));
  return new Catalogue(tables);
}

test("tables and numbers offer the same", async () => {
  const [real, numbers] = [await fox(2), new Catalogue(new NumberOffers(FOX))];
  assert.deepEqual(real.names, numbers.names);
  assert.equal(real.durationS, numbers.durationS);
  assert.equal(real.fileBytes("airgs.json"), numbers.fileBytes("airgs.json"));
  for (let s = 0; s < real.segments; s++) {
    assert.deepEqual(real.span(s).stop, numbers.span(s).stop);
    for (const decoded of [NONE, new Set([0]), new Set([2, 3]), new Set([1])]) {
      assert.deepEqual(real.options(s, decoded), numbers.options(s, decoded));
      assert.deepEqual(real.batch(s, 1, decoded), numbers.batch(s, 1, decoded));
    }
    assert.deepEqual(real.bytesAfter(s), numbers.bytesAfter(s));
  }
});

test("before its table is there a group can be guessed at, and no further", async () => {
  const c = await fox(1);
  assert.deepEqual([c.knows(0), c.knows(1)], [true, false]);
  assert.deepEqual(c.span(1), { start: 2, stop: 4 });
  assert.equal(c.upcoming(0, 5, Infinity).length, 1);
  assert.throws(() => c.options(1, NONE), /group\/2.json.gz/);
});

test("positions, loops and groups", async () => {
  const c = await fox(2);
  assert.deepEqual(c.place(5), { loop: 2, segment: 1 });
  assert.deepEqual(c.group(5), { loop: 2, group: 1 });
  assert.deepEqual([c.end(3), c.end(Infinity)], [6, Infinity]);
  assert.equal(c.loops(null), 180); // of a sixth of a second
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
  const group = { table: 1, sidecars: [100], pictures: [[900, 400]], segments: [segment, segment] };
  const levels = [0, 1].map((j) => ({ id: `L${j}`, tiers: 1, pruned: j / 2 }));
  const numbers = { name: "", frame_rate: [10, 1], header_bytes: 0, root_bytes: 0, page_bytes: 0, levels };
  const c = new Catalogue(new NumberOffers({ ...numbers, qualities: ["Q0", "Q1"], groups: [group] }), 0);
  assert.deepEqual(new RungTotals(c).read(), [
    { name: "Q0+L0", psnr: 40, kbps: 12, onLadder: true },
    { name: "Q0+L1", psnr: 30, kbps: 8, onLadder: false },
    { name: "Q1+L0", psnr: 36, kbps: 10, onLadder: true },
    { name: "Q1+L1", psnr: 35, kbps: 6, onLadder: true },
  ]);
  assert.ok(new RungTotals(await fox(1)).read()[0].kbps > 0);
  assert.deepEqual(new RungTotals(await fox(0)).read()[0], { name: "Q0+L0", psnr: null, kbps: 0, onLadder: true });
});

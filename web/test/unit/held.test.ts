// What a player fetches for groups that keep rows of an earlier one: numbers that can be added up by hand.
import assert from "node:assert/strict";
import { test } from "node:test";
import { type Keyframes, NONE, Offers, optionsOf, sizesOf } from "../../src/play/offers.ts";
import { sizesAfter } from "../../src/play/policies/mpc.ts";
import { RungTotals } from "../../src/play/rungs.ts";
import { Session } from "../../src/play/session.ts";
import { Stores } from "../../src/play/stores.ts";
import { playoutOf, rulesOf, SimulatedDownloader, Trace } from "../support/link.ts";
import { type GroupNumbers, NumberTables } from "../support/offers.ts";
import { makePolicy } from "../support/policies.ts";

const SEGMENT = {
  frames: 10,
  bytes: [7, 3],
  psnr: [
    [40, 38],
    [36, 35],
  ],
};
const BASE: GroupNumbers = {
  table: 10,
  sidecars: [100, 200],
  pictures: [
    [1000, 300],
    [2000, 600],
  ],
  segments: [SEGMENT, SEGMENT],
};

/** A group that differs from group 1 in tier 0 alone. */
const differing = (pictures: number[]): GroupNumbers => ({
  ...BASE,
  ...{ sidecars: [10, 20], pictures: [pictures, [0, 0]], base: 1 },
});
const [SOME, ONE] = [differing([50, 15]), differing([70, 35])];

/** Three groups of two segments; L0 needs both tiers, L1 the first. Files come without headers. */
class Viewer {
  readonly tables = new NumberTables({
    ...{ name: "", frame_rate: [10, 1], header_bytes: 0, root_bytes: 1, page_bytes: 0, qualities: ["Q0", "Q1"] },
    levels: [0, 1].map((j) => ({ id: `L${j}`, tiers: 2 - j, pruned: j / 2 })),
    groups: [BASE, SOME, ONE],
  });
  readonly offers = new Offers(this.tables, 0);
  readonly settings = rulesOf({ loops: 2, startupS: 0 });
  readonly playout = playoutOf(this.offers, this.settings);
  readonly stores = new Stores(this.offers);
  readonly downloader = new SimulatedDownloader({ trace: new Trace([0], [1e9], 3600), rttS: 0.05 }, this.offers);

  /** Plays from a position on in a rung, and gives the keyframes that are asked for by position. */
  async keys(policy: string, from = 0): Promise<Map<number, readonly string[]>> {
    const first = this.downloader.requests.length;
    const parts = { ...this, policy: makePolicy(policy, this.offers) };
    for await (const _ of new Session(parts, new AbortController().signal, from).run());
    const asked = this.downloader.requests.slice(first).filter(({ batch }) => batch.keyframes.length);
    return new Map(asked.map(({ position, batch }) => [position, batch.keyframes]));
  }
}

const all = (quality: number, ...groups: number[]) =>
  groups.flatMap((group) =>
    [0, 1].flatMap((tier) => [`keyframe/T${tier}/${group}.bin`, `keyframe/T${tier}/Q${quality}/${group}.m4s`]),
  );

test("the bytes of a group that keeps rows depend on what is held of the other", () => {
  const { offers } = new Viewer();
  const both = new Set([0, 1]);
  const sizes = (segment: number, decoded: Keyframes) => [...sizesOf(offers.of(segment), decoded)];
  assert.deepEqual(sizes(2, NONE), [3387, 1163, 1252, 428]);
  assert.deepEqual(sizes(2, both), [87, 63, 1252, 428]);
  assert.deepEqual(sizes(2, new Set([0, 1, 4, 5])), [7, 3, 1252, 428]);
  assert.deepEqual(sizes(4, new Set([0])), [2307, 83, 1272, 448]);
  assert.equal(optionsOf(offers.of(2), both)[0].sizeBytes, 87);
  assert.equal(optionsOf(offers.of(2), NONE)[0].sizeBytes, 3387);
});

test("at the start of a group the rung before tells what is held", () => {
  const { offers } = new Viewer();
  assert.deepEqual([...sizesAfter(offers.of(0), offers.of(5), NONE)], [...sizesOf(offers.of(0), NONE)]);
  const second = [...sizesAfter(offers.of(2), offers.of(1), NONE)];
  assert.deepEqual(second.slice(0, 4), [...sizesOf(offers.of(2), new Set([0, 1]))]);
  assert.deepEqual(second.slice(12), [...sizesOf(offers.of(2), new Set([2]))]);
  const known = [...sizesAfter(offers.of(4), offers.of(3), new Set([2, 3]))]; // as group 2 keeps rows of group 1, too
  assert.deepEqual(known.slice(0, 4), [107, 83, 72, 48]);
  const { groups } = new Viewer().tables.numbers;
  groups[1] = { ...BASE };
  const other = new Offers(new NumberTables({ ...new Viewer().tables.numbers, groups }), 0);
  const scratch = [...sizesOf(other.of(4), NONE)]; // group 2 tells nothing of it
  assert.deepEqual([...sizesAfter(other.of(4), other.of(3), NONE)], [scratch, scratch, scratch, scratch].flat());
});

test("what was decoded of a group is not fetched for another, and again in the next loop", async () => {
  const keyframes = await new Viewer().keys("fixed:0");
  const later = ["keyframe/T0/2.bin", "keyframe/T0/Q0/2.m4s", "keyframe/T1/2.bin"];
  const last = ["keyframe/T0/3.bin", "keyframe/T0/Q0/3.m4s", "keyframe/T1/3.bin"];
  const loop = [all(0, 1), later, last];
  assert.deepEqual([...keyframes.keys()], [0, 2, 4, 6, 8, 10]);
  assert.deepEqual([...keyframes.values()], [...loop, ...loop]);
});

test("who joins in the middle reads what is kept there, and needs it but once", async () => {
  const viewer = new Viewer();
  const keyframes = await viewer.keys("fixed:0", 2);
  const second = ["keyframe/T0/2.bin", "keyframe/T0/Q0/2.m4s", "keyframe/T0/1.bin", "keyframe/T0/Q0/1.m4s"];
  assert.deepEqual(keyframes.get(2), [...second, "keyframe/T1/2.bin", "keyframe/T1/1.bin", "keyframe/T1/Q0/1.m4s"]);
  assert.deepEqual(keyframes.get(4), ["keyframe/T0/3.bin", "keyframe/T0/Q0/3.m4s", "keyframe/T1/3.bin"]);
  const tables = viewer.downloader.requests.flatMap(({ batch }) => batch.tables);
  assert.deepEqual(tables, ["airgs.json", "group/2.json.gz", "group/1.json.gz", "group/3.json.gz"]);
});

test("the table of the other group may stand on a page that nobody has read", () => {
  const { numbers } = new Viewer().tables;
  const groups = [...new Array(65).fill(BASE), { ...SOME, base: 3 }];
  const { tables } = new Stores(new Offers(new NumberTables({ ...numbers, groups })));
  const read = (path: string) => {
    const batch = { keyframes: [], delta: [], tables: [path] };
    const request = { kind: "tables" as const, position: 0, rung: 0, batch, sentS: 0 };
    const times = { firstByteS: 0, atS: 0, bytes: 1, abandoned: false, cached: false };
    tables.add({ request, ...times, whole: [path], refused: new Map() });
  };
  const asked: string[] = [];
  for (let [path] = tables.missing(130, 132); path; [path] = tables.missing(130, 132)) {
    asked.push(path);
    read(path);
  }
  assert.deepEqual(asked, ["group/66.json.gz", "index/1/1.json", "group/3.json.gz"]);
});

test("another quality needs the other group in that quality", async () => {
  const viewer = new Viewer();
  await viewer.keys("fixed:Q0+L0");
  viewer.playout.restart();
  const again = await viewer.keys("fixed:Q1+L0", 2);
  const second = ["keyframe/T0/2.bin", "keyframe/T0/Q1/2.m4s", "keyframe/T0/1.bin", "keyframe/T0/Q1/1.m4s"];
  assert.deepEqual(again.get(2), [...second, "keyframe/T1/2.bin", "keyframe/T1/1.bin", "keyframe/T1/Q1/1.m4s"]);
});

test("a tier is shown when what it keeps is there as well", async () => {
  const { offers, stores, downloader, playout } = new Viewer();
  const batch = stores.keyframes.missing(2, 0);
  const request = { kind: "group" as const, position: 2, rung: 0, batch, sentS: 0 };
  const arrival = await downloader.fetch(request, null, new AbortController().signal);
  stores.keyframes.add({ ...arrival, whole: batch.keyframes.slice(0, 5) }); // no table of tier 1 of the other group
  const decoded = [0, 1, 4, 5].filter((number) => stores.keyframes.decoded(2).has(number));
  assert.deepEqual([decoded, stores.keyframes.shownTiers(2, 0)], [[0, 4, 5], 1]);
  assert.deepEqual(stores.keyframes.missing(2, 0).keyframes, ["keyframe/T1/1.bin", "keyframe/T1/Q0/1.m4s"]);
  stores.keyframes.add(arrival);
  assert.equal(stores.keyframes.shownTiers(2, 0), 2);
  assert.deepEqual([offers.knows(2), playout.end], [true, 12]);
});

test("however many loops are buffered, their keyframes are known until they have been played", async () => {
  const { offers, stores, downloader } = new Viewer();
  for (let position = 0; position < offers.end(200); position += offers.segments) {
    const batch = stores.keyframes.missing(position, 0);
    const request = { kind: "group" as const, position, rung: 0, batch, sentS: 0 };
    stores.keyframes.add(await downloader.fetch(request, null, new AbortController().signal));
  }
  const known = (loop: number) => stores.keyframes.decoded(loop * offers.segments).has(0);
  assert.deepEqual([0, 199].map(known), [true, true]);
  stores.keyframes.forget(100 * offers.segments + 1);
  assert.deepEqual([99, 100, 199].map(known), [false, true, true]);
});

test("before the table of the other group is there nothing is said of bytes", () => {
  const { tables, offers } = new Viewer();
  tables.has = (group: number) => group === 1;
  assert.deepEqual([offers.knows(2), offers.span(2).start, offers.upcoming(2, 4)], [false, 20, []]);
  assert.equal(new RungTotals(offers).read()[0].kbps, 0);
});

test("people see what a rung costs where the group before is there", () => {
  const { offers } = new Viewer();
  const bytes = 3300 + 80 + 100 + 6 * 7 + 3 * 10 + 1; // keyframes of three groups in Q0, six deltas, tables, airgs.json
  assert.equal(new RungTotals(offers).read()[0].kbps, (8 * bytes) / 6 / 1000);
});

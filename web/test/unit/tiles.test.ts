// What a player fetches of a scene in tiles: what is expected in sight early, what is lacking late.
import assert from "node:assert/strict";
import { test } from "node:test";
import { ByView } from "../../src/play/fetch-plan.ts";
import { missing, NONE, Offers, sizesOf } from "../../src/play/offers.ts";
import type { Playout } from "../../src/play/playout.ts";
import { sizesAfter } from "../../src/play/policies/mpc.ts";
import { Repairs } from "../../src/play/repairs.ts";
import { Session } from "../../src/play/session.ts";
import { byView } from "../../src/play/settings.ts";
import { Boxes, cameraOf, expected, type ViewState, velocityOf, Watcher } from "../../src/play/sight.ts";
import { Stores } from "../../src/play/stores.ts";
import { playoutOf, rulesOf, SimulatedDownloader, Trace } from "../support/link.ts";
import { type GroupNumbers, NumberTables } from "../support/offers.ts";
import { makePolicy } from "../support/policies.ts";

const RADIANS = Math.PI / 180;

/** Who stands in the middle and looks at so many degrees from z towards x. */
const turned = (degrees: number): ViewState => ({
  position: [0, 0, 0],
  forward: [Math.sin(degrees * RADIANS), 0, Math.cos(degrees * RADIANS)],
  up: [0, -1, 0],
  fovY: 60,
  near: 0.01,
});

const towards = (degrees: number) => cameraOf(turned(degrees), 100, 100);
/** A small box at so many degrees, ten units away. */
function boxAt(degrees: number, half = 0.001) {
  const centre = turned(degrees).forward.map((axis) => 10 * axis);
  return { low: centre.map((axis) => axis - half), high: centre.map((axis) => axis + half) };
}

const near = (a: ArrayLike<number>, b: ArrayLike<number>, tolerance = 1e-9) =>
  Array.from(a).forEach((value, i) => {
    assert.ok(Math.abs(value - b[i]!) <= tolerance, `${Array.from(a)} is not ${Array.from(b)}`);
  });

test("a movement is expected to go on and to die down", () => {
  const velocity = velocityOf(towards(-2), towards(3)); // 50 degrees a second
  near(velocity.turn, [0, -50 * RADIANS, 0]);
  const passed = 50 * 0.5 * (1 - Math.exp(-0.8 / 0.5));
  near(expected(towards(3), velocity, 0.8).worldToCamera, towards(3 + passed).worldToCamera);
  near(expected(towards(3), velocity, -1).worldToCamera, towards(3).worldToCamera);
  near(expected(towards(3), velocity, 100).worldToCamera, towards(28).worldToCamera);
});

test("who walks is expected to walk on", () => {
  const at = (x: number) => cameraOf({ ...turned(20), position: [x, 1, 2] }, 100, 100);
  const velocity = velocityOf(at(0), at(0.4));
  near(velocity.shift, [4, 0, 0]);
  near(expected(at(0.4), velocity, 100).worldToCamera, at(2.4).worldToCamera);
});

test("by how many degrees boxes are beside a picture", () => {
  const boxes = new Boxes([boxAt(0), boxAt(45), boxAt(-180), { low: [-1, -1, 5], high: [1, 9, 6] }]);
  near(boxes.degreesOff(towards(0)), [-30, 15, 150, -20.58], 0.02);
  const wide = cameraOf(turned(0), 200, 100); // as high, and 98 degrees wide
  near(boxes.degreesOff(wide).slice(0, 2), [-30, 45 - Math.atan(2 * Math.tan(Math.PI / 6)) / RADIANS], 0.02);
});

test("a watcher remembers how its viewer stood a moment ago", () => {
  const watcher = new Watcher();
  watcher.resize(100, 100);
  assert.equal(watcher.at(0), null);
  for (const [atS, degrees] of [
    [1, 0],
    [2, 10],
    [2.05, 20],
    [2.09, 30],
    [2.12, 40],
  ] as const) {
    watcher.look(turned(degrees), atS);
  }
  const seen = (atS: number) => watcher.at(atS)!.worldToCamera;
  near(seen(2.12), towards(40).worldToCamera);
  near(seen(2.02), towards(10).worldToCamera);
  near(seen(0), towards(10).worldToCamera); // what is longer ago is forgotten
});

// Four tiles, in front, at 60 degrees to the right, behind and, without rows, in front; two tiers of each.

const SEGMENT = {
  frames: 10,
  bytes: [0, 1, 2].flatMap((tile) => [50 + tile, 20 + tile]).concat([0, 0]),
  psnr: [
    [40, 38],
    [36, 35],
  ],
};
const GROUP: GroupNumbers = {
  table: 10,
  rows: [9, 9, 9, 9, 9, 9, 0, 0],
  sidecars: [10, 20, 10, 20, 10, 20, 0, 0],
  pictures: [...[0, 1, 2].flatMap((tile) => [[1000 + tile, 300], [2000 + tile, 600]]), [0, 0], [0, 0]], // biome-ignore format: by unit
  segments: [SEGMENT, SEGMENT, SEGMENT, SEGMENT],
  boxes: [boxAt(0), boxAt(60), boxAt(180), boxAt(0)],
};

const offersOf = (group: GroupNumbers) =>
  new NumberTables({
    ...{ name: "", frame_rate: [10, 1], header_bytes: 0, root_bytes: 1, page_bytes: 0, qualities: ["Q0", "Q1"] },
    levels: [0, 1].map((j) => ({ id: `L${j}`, tiers: 2 - j, pruned: j / 2 })),
    tiles: 4,
    groups: [group],
  });

test("sizes are those of the tiles that are asked for", () => {
  const c = new Offers(offersOf(GROUP), 0);
  const sizes = (tiles: number[], decoded = NONE) => sizesOf(c.of(0, tiles), decoded);
  assert.deepEqual([...sizes([1])], [3083, 1032, 981, 331]);
  assert.equal(c.of(0, [0, 1, 2, 3]), c.of(0));
  assert.equal(c.of(0, [1]), c.of(0, [1]));
  const sums = [0, 1, 2].map((tile) => sizes([tile]));
  near(
    sizesOf(c.of(0), NONE),
    sums[0]!.map((size, rung) => size + sums[1]![rung]! + sums[2]![rung]!),
  );
  assert.deepEqual(missing(c.of(1, [1]), 0, new Set([2])), {
    keys: ["key/P2/T1/1.bin", "key/P2/T1/Q0/1.m4s"],
    state: ["state/P2/L0/2.m4s"],
    tables: [],
  });
  const after = sizesAfter(c.of(1, [1]), c.of(0, [1]), NONE);
  assert.deepEqual([...after.subarray(0, 4)], [51, 21, 981, 331]); // after Q0+L0
  const shown = (tiles: number[]) => c.of(0, tiles).rungs.map(({ gaussians }) => gaussians);
  assert.deepEqual(shown([1]), shown([0, 1, 2, 3])); // a budget is for what may come into sight
});

/** A player in a simulated second, whose viewer turns from 0 degrees on. */
class Viewer {
  readonly offers: Offers;
  readonly watcher = new Watcher();
  readonly settings = { ...byView(rulesOf({ startupS: 0, bufferS: 10 })), loops: 1 };
  readonly playout: Playout;
  readonly stores: Stores;
  readonly downloader: SimulatedDownloader;
  readonly planner: ByView;

  constructor(group = GROUP, rateBps = 1e9) {
    this.offers = new Offers(offersOf(group), 0);
    this.playout = playoutOf(this.offers, this.settings);
    this.stores = new Stores(this.offers);
    this.downloader = new SimulatedDownloader({ trace: new Trace([0], [rateBps], 3600), rttS: 0.05 }, this.offers);
    this.planner = new ByView(this.offers, this.playout, this.watcher);
    this.watcher.resize(100, 100);
    this.watcher.look(turned(0), 0);
  }

  /** Fetches all segments. */
  async play(policy: string): Promise<void> {
    const parts = { ...this, policy: makePolicy(policy, this.offers) };
    for await (const _ of new Session(parts, new AbortController().signal).run());
  }

  files(): string[] {
    return this.downloader.requests.flatMap(({ batch }) => [...batch.keys, ...batch.state]);
  }
}

test("a session fetches the tiles that are expected in sight, and counts them alone", async () => {
  const viewer = new Viewer();
  await viewer.play("fixed:Q0+L0");
  assert.deepEqual(viewer.files().slice(0, 5), [
    ...["key/P1/T0/1.bin", "key/P1/T0/Q0/1.m4s", "key/P1/T1/1.bin", "key/P1/T1/Q0/1.m4s"],
    "state/P1/L0/1.m4s",
  ]);
  assert.ok(!viewer.files().some((path) => path.includes("/P3/")));
  assert.deepEqual([...viewer.playout.slots[0]!.tiles], [[0, 0]]);
  assert.equal(viewer.playout.earliestRequestS(4, 0), viewer.playout.slots[3]!.startAt); // there is room for two segments
});

test("a tile that cannot be had is left out, and the others are shown", async () => {
  const viewer = new Viewer({ ...GROUP, boxes: [0, 10, 20, 0].map((degrees) => boxAt(degrees)) });
  for (const quality of [0, 1]) viewer.stores.unusable.add(`key/P2/T0/Q${quality}/1.m4s`);
  await viewer.play("fixed:Q0+L0");
  assert.deepEqual([...viewer.playout.slots[0]!.tiles], [[0, 0], [2, 0]]); // biome-ignore format: a line
});

test("who turns gets what he turns to, and who sees nothing the tile that is nearest", () => {
  const viewer = new Viewer();
  assert.deepEqual(viewer.planner.plan(0, 0), [0]);
  viewer.watcher.look(turned(10), 0.1); // 100 degrees a second, so that 50 more are expected
  assert.deepEqual(viewer.planner.plan(0, 0.1), [0, 1]);
  viewer.watcher.look(turned(110), 5);
  assert.deepEqual(viewer.planner.plan(0, 9), [1]);
  viewer.watcher.look(turned(130), 10);
  assert.deepEqual(viewer.planner.plan(0, 19), [2]);
});

test("what is lacking soon before a segment is shown is looked for in a wider picture", () => {
  const viewer = new Viewer();
  viewer.playout.enqueue(0, 0, 0, [0]);
  viewer.playout.enqueue(1, 0, 0, [0]);
  const lacking = (atS: number) => viewer.planner.lacking(atS).map(({ slot, tile }) => [slot.position, tile]);
  assert.deepEqual(lacking(0.5), [[0, 1]]); // at 60 degrees, 30 beside the picture
  assert.deepEqual(lacking(0.75), [[0, 1], [1, 1]]); // biome-ignore format: a line
  viewer.watcher.look(turned(-5), 0.8);
  assert.deepEqual(lacking(0.95), []);
  viewer.watcher.look(turned(170), 1);
  assert.deepEqual(lacking(1.5), [[1, 2]]);
  viewer.playout.addTile(viewer.playout.slots[1]!, 2, 3);
  assert.deepEqual(lacking(1.5), []);
  assert.deepEqual(lacking(99), []); // the last picture stands
  viewer.watcher.look(turned(60), 99);
  assert.deepEqual(lacking(100), [[1, 1]]);
});

function repairsOf(viewer: Viewer, onProblem = (error: unknown): void => assert.fail(String(error))) {
  return new Repairs({ ...viewer, onEvent: () => {}, onProblem }, new AbortController().signal);
}

const settled = () => new Promise((resolve) => setTimeout(resolve));

/** Lets repairs look once, and waits for what they fetch. */
async function repaired(viewer: Viewer, atS: number): Promise<Map<number, number>> {
  const repairs = repairsOf(viewer);
  repairs.look(atS);
  repairs.look(atS); // what is on its way is not asked for again
  await settled();
  return viewer.playout.slots[0]!.tiles;
}

test("what is lacking is fetched in the rung of its segment", async () => {
  const viewer = new Viewer();
  viewer.playout.enqueue(0, 0, 0, [0]);
  viewer.watcher.look(turned(20), 0.1);
  assert.deepEqual([...(await repaired(viewer, 0.4))], [[0, 0], [1, 0]]); // biome-ignore format: a line
  assert.deepEqual(
    viewer.files().map((path) => path.split("/")[1]),
    new Array(5).fill("P2"),
  );
  assert.equal(viewer.downloader.requests.length, 1);
  assert.equal(viewer.stores.keys.shownTiers(0, 0, 1), 2);
});

test("what would come when its segment is over is fetched in the smallest rung", async () => {
  const viewer = new Viewer();
  viewer.stores.downloads.push({ atS: 0, download: { bytes: 1000, seconds: 1 } });
  viewer.playout.enqueue(0, 0, 0, [0]);
  viewer.watcher.look(turned(20), 0.1);
  assert.deepEqual([...(await repaired(viewer, 0.4))], [[0, 0], [1, 3]]); // biome-ignore format: a line
});

test("files on their way are not asked for twice, broken ones not again", async () => {
  const viewer = new Viewer();
  viewer.playout.enqueue(0, 0, 0, [0]);
  viewer.watcher.look(turned(20), 0.1);
  viewer.stores.coming.add(["key/P2/T0/1.bin"]);
  assert.equal((await repaired(viewer, 0.4)).size, 1);
  viewer.stores.coming.remove(["key/P2/T0/1.bin"]);
  for (const level of [0, 1]) viewer.stores.unusable.add(`state/P2/L${level}/1.m4s`);
  assert.equal((await repaired(viewer, 0.4)).size, 1);
  assert.deepEqual(viewer.files(), []);
});

test("what would come too late in the smallest rung as well is not fetched", async () => {
  const viewer = new Viewer();
  viewer.playout.enqueue(0, 0, 0, [0]); // shown from 0.004 s to 1.004 s
  viewer.playout.enqueue(1, 0, 0, [0]);
  viewer.watcher.look(turned(20), 0.1);
  const smallest = viewer.stores.keys.options(0, [1])[3]!.sizeBytes;
  const at = (endS: number) => {
    viewer.stores.downloads.length = 0; // it takes until endS, from 0.4 s on, a round trip of 0.05 s and decoding
    viewer.stores.downloads.push({ atS: 0, download: { bytes: smallest, seconds: endS - 0.4 - 0.05 - 0.004 } });
    const [slot] = viewer.playout.slots;
    return repairsOf(viewer).option({ slot: slot!, tile: 1 }, 0.4)?.index;
  };
  assert.deepEqual([at(1.003), at(1.005)], [3, undefined]);
  assert.equal((await repaired(viewer, 0.4)).size, 1);
  assert.deepEqual(viewer.files(), []);
});

test("while a viewer pauses, a tile comes late as it is wanted", async () => {
  const viewer = new Viewer(GROUP, 8000); // a tile takes four seconds
  viewer.stores.downloads.push({ atS: 0, download: { bytes: 1000, seconds: 1 } });
  viewer.playout.enqueue(0, 0, 0, [0]);
  viewer.playout.enqueue(1, 0, 0, [0]);
  viewer.watcher.look(turned(20), 0.1);
  viewer.playout.freeze(0.4);
  assert.deepEqual([...(await repaired(viewer, 0.4))], [[0, 0], [1, 0]]); // biome-ignore format: a line
  assert.ok(viewer.downloader.now() > 3);
});

test("a repair that fails is told of once, and so is looking", async () => {
  const viewer = new Viewer();
  viewer.playout.enqueue(0, 0, 0, [0]);
  viewer.watcher.look(turned(20), 0.1);
  const problems: unknown[] = [];
  const repairs = repairsOf(viewer, (error) => problems.push(error));
  const wrong = new Error("made up");
  viewer.downloader.fetch = () => Promise.reject(wrong);
  for (let look = 0; look < 2; look++) {
    repairs.look(0.4);
    await settled();
  }
  assert.deepEqual(problems, [wrong]);
  viewer.planner.lacking = () => {
    throw wrong;
  };
  await repairs.run();
  assert.deepEqual(problems, [wrong, wrong]);
});

test("a session waits for files that a repair fetches", async () => {
  const viewer = new Viewer();
  const [path] = ["key/P1/T0/1.bin"];
  const { coming } = viewer.stores;
  coming.add([path]);
  coming.add([path]); // by two, of whom one ends before the other
  const asked: number[] = [];
  const wait = viewer.downloader.wait.bind(viewer.downloader);
  viewer.downloader.wait = (untilS) => {
    if (coming.has(path)) asked.push(viewer.files().length);
    coming.remove([path]);
    return wait(untilS);
  };
  await viewer.play("fixed:Q0+L0");
  assert.deepEqual(asked, [0, 0]);
  assert.equal(viewer.files()[0], path); // it did not come
});

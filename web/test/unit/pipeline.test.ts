// What is decoded ahead of the screen, in what order: the page has no chance to show anything for many segments.
import assert from "node:assert/strict";
import { test } from "node:test";
import { setTimeout } from "node:timers/promises";
import { Ahead } from "../../src/media/bell.ts";
import type { Media } from "../../src/media/client.ts";
import { Offers } from "../../src/play/offers.ts";
import { Pipeline } from "../../src/play/pipeline.ts";
import { Stores } from "../../src/play/stores.ts";
import { playoutOf, rulesOf } from "../support/link.ts";
import { NumberTables } from "../support/offers.ts";

const FPS = 100;
const SEGMENTS = 6; // of a frame each
const MOST_AHEAD = 2;
const FRAME = { luma: new Uint8Array(1), means: new Float32Array(3), time: 0, bases: null };

type Take = (t: number, frame: object) => void;

class NumberedTables extends NumberTables {
  group() {
    return { levels: [null] };
  }
}

/** Of a test that would otherwise wait for ever. */
const timeout = 60_000;

test("where a hold takes time back, segments are still decoded in their order", { timeout }, async () => {
  const numbers = {
    ...{ name: "", frame_rate: [FPS, 1], header_bytes: 0, root_bytes: 0, page_bytes: 0, qualities: ["Q0"] },
    levels: [{ id: "L0", tiers: 1, pruned: 0 }],
  };
  const segments = new Array(SEGMENTS).fill({ frames: 1, bytes: [1000], psnr: [[40]] });
  const tables = new NumberedTables({ ...numbers, groups: [{ table: 0, sidecars: [0], pictures: [[0]], segments }] });
  const offers = new Offers(tables, 0);
  const rules = rulesOf({ startupS: 0, resumeS: 0, decodeFrameS: 0, bufferS: 99, loops: 1 });
  const playout = playoutOf(offers, rules);
  const stores = new Stores(offers);

  const ahead = new Ahead(1e6, MOST_AHEAD);
  const ids = new Map<object, number>();
  const begun: number[] = [];
  const media = {
    tables,
    canonical: async (name: object) => name,
    taken: (frame: object) => ahead.taken(ids.get(frame)!, 0),
    segment: async (index: number, _level: number, _of: object, take: Take, signal: AbortSignal) => {
      await ahead.place(signal);
      await setTimeout(2e3 / FPS); // the clock goes on by two segments
      begun.push(index);
      const frame = { ...FRAME };
      ids.set(frame, index);
      ahead.give(index, 0, 1);
      take(0, frame);
      return 1;
    },
  } as unknown as Media;
  const pipeline = new Pipeline({
    ...{ media, offers, stores, playout, onProgress: () => {} },
    onProblem: (error) => assert.fail(String(error)),
  });

  const beganS = performance.now() / 1e3;
  for (let position = 0; position < SEGMENTS; position++) playout.enqueue(position, 0, beganS);
  pipeline.due(0, 0);
  await setTimeout(12e3 / FPS);
  playout.hold(beganS, "display", true);
  for (let position = 0; position < SEGMENTS; position++) {
    pipeline.due(position, 0);
    while (!pipeline.clip(position)?.frames[0]) await setTimeout(1);
    pipeline.shown(pipeline.clip(position)!, 0);
  }
  assert.deepEqual(begun, [0, 1, 2, 3, 4, 5]);
});

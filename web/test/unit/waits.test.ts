// Three ways to wait, by a clock that tests turn: for bytes, for the decoder and for the display.
import assert from "node:assert/strict";
import { test } from "node:test";
import { Offers } from "../../src/play/offers.ts";
import type { Playout } from "../../src/play/playout.ts";
import { Statistics } from "../../src/play/statistics.ts";
import { Waits } from "../../src/play/waits.ts";
import { playoutOf, rulesOf } from "../support/link.ts";
import { NumberTables } from "../support/offers.ts";

const FPS = 10;
const SEGMENTS = 8;
const TICK_S = 1 / 60;

/** Plays segments of a second; what a frame lacks is said by the test, and one is drawn when nothing lacks. */
class Page {
  readonly statistics = new Statistics();
  readonly playout: Playout;
  readonly waits: Waits;
  nowS = 0;
  /** Positions and frames of pictures. */
  frame: readonly [number, number] | null = null;

  constructor(arrivals: number[], sounds = () => false) {
    const segment = { frames: FPS, bytes: [1000], psnr: [[40]] };
    const tables = new NumberTables({
      ...{ name: "", frame_rate: [FPS, 1], header_bytes: 0, root_bytes: 0, page_bytes: 0, qualities: ["Q0"] },
      levels: [{ id: "L0", tiers: 1, pruned: 0 }],
      groups: [{ table: 0, sidecars: [100], pictures: [[1000]], segments: new Array(SEGMENTS).fill(segment) }],
    });
    const offers = new Offers(tables, 0);
    this.playout = playoutOf(offers, rulesOf({ startupS: 0, resumeS: 0, decodeFrameS: 0, bufferS: 99, loops: 1 }));
    this.waits = new Waits(this.playout, sounds);
    this.arrivals = arrivals;
  }

  private readonly arrivals: number[];

  /** Until a moment, the display takes a picture every `everyS`. */
  run(untilS: number, { lack = null as "decoder" | "display" | "start" | null, draws = true, everyS = TICK_S } = {}) {
    for (; this.nowS < untilS - 1e-9; this.nowS += everyS) {
      const { nowS, playout, statistics } = this;
      while (this.arrivals.length && this.arrivals[0] <= nowS) {
        playout.enqueue((playout.last?.position ?? -1) + 1, 0, this.arrivals.shift()!);
      }
      this.waits.tick(nowS);
      const due = playout.at(nowS);
      const here = this.frame && FPS * this.frame[0] + this.frame[1];
      const wanted = due && FPS * due.slot.position + due.frame;
      const isNew = wanted !== null && wanted !== here;
      this.waits.lack(nowS, isNew ? lack : null);
      if (isNew && !lack) {
        statistics.shown({ late: wanted - (here ?? wanted - 1) - 1, lost: 0 });
        this.frame = [due!.slot.position, due!.frame];
      }
      if (draws) statistics.drawn(nowS);
    }
    return this;
  }

  get counts() {
    const { stalls, stallS, ...stats } = this.statistics.read(this.nowS, this.playout, null, null);
    const { framesShown, framesDropped, droppedByDecoder, droppedByDisplay } = stats;
    assert.equal(framesDropped, droppedByDecoder + droppedByDisplay);
    return { stalls, stallS: Math.round(10 * stallS) / 10, framesShown, droppedByDecoder, droppedByDisplay };
  }
}

const NONE = { stalls: 0, stallS: 0, droppedByDecoder: 0, droppedByDisplay: 0 };

test("what is in time is neither a stall nor dropped", () => {
  assert.deepEqual(new Page([0, 0, 0]).run(3).counts, { ...NONE, framesShown: 30 });
});

test("a wait for bytes is a stall and drops nothing, also where the page has no chance to show anything", () => {
  assert.deepEqual(new Page([0, 0, 5]).run(6).counts, { ...NONE, stalls: 1, stallS: 3, framesShown: 30 });
  const seldom = new Page([0, 0, 5]).run(2).run(4.8, { everyS: 0.7 }).run(6);
  assert.deepEqual(seldom.counts, { ...NONE, stalls: 1, stallS: 3, framesShown: 30 });
});

test("a wait for the decoder is dropped frames by their time, and no stall", () => {
  const page = new Page([0, 0, 0]).run(1).run(2.5, { lack: "decoder" }).run(4.5);
  assert.deepEqual(page.counts, { ...NONE, droppedByDecoder: 15, framesShown: 30 });
});

test("a decoder at half the rate drops half of the frames", () => {
  const page = new Page([0, 0, 0]);
  for (let s = 0; s < 3; s += 0.2) page.run(s + 0.1, { lack: "decoder" }).run(s + 0.2);
  const { framesShown, droppedByDecoder, ...rest } = page.counts;
  assert.deepEqual(rest, { stalls: 0, stallS: 0, droppedByDisplay: 0 });
  assert.ok(Math.abs(framesShown - 15) <= 1 && Math.abs(droppedByDecoder - 15) <= 1);
});

test("a wait for the display, frames it has no time for and frames that are not drawn are dropped by it", () => {
  const waited = new Page([0, 0, 0]).run(1).run(2, { lack: "display" }).run(4);
  assert.deepEqual(waited.counts, { ...NONE, droppedByDisplay: 10, framesShown: 30 });
  const seldom = new Page([0, 0, 0]).run(3, { everyS: 0.2 });
  assert.deepEqual(seldom.counts, { ...NONE, droppedByDisplay: 14, framesShown: 15 });
  const busy = new Page([0, 0, 0]).run(1).run(2, { draws: false }).run(3);
  assert.deepEqual(busy.counts, { ...NONE, droppedByDisplay: 9, framesShown: 21 });
});

test("a display that takes a picture every second goes on a quarter of a second at a time, and tells of the rest", () => {
  const page = new Page([0, 0, 0]).run(9, { everyS: 1 });
  const { framesShown, droppedByDisplay, ...rest } = page.counts;
  assert.deepEqual(rest, { stalls: 0, stallS: 0, droppedByDecoder: 0 });
  assert.equal(framesShown, 9);
  assert.ok(droppedByDisplay >= 70 && page.playout.at(page.nowS)!.slot.position >= 1);
});

test("before the first picture and that of a seek nothing is dropped", () => {
  const page = new Page([0, 0, 0]).run(2, { lack: "start" }).run(4);
  assert.deepEqual(page.counts, { ...NONE, framesShown: 20 });
});

test("sound that is heard goes on without a picture for a moment, then waits as well until all is well again", () => {
  let heard = true;
  const page = new Page([0, 0, 0], () => heard).run(1).run(1.15, { lack: "decoder" }).run(2);
  assert.deepEqual([page.counts.droppedByDecoder, page.playout.at(2)!.slot.position], [0, 2]);
  assert.ok(page.waits.calm(2));
  page.run(2.5, { lack: "decoder" });
  heard = false; // it ends with the schedule
  page.run(2.8);
  assert.ok(page.playout.schedule.held === false && !page.waits.calm(2.8) && page.waits.calm(3.1));
  assert.ok(page.playout.schedule.at(2.8) < 2.6);
});

test("while sound is heard, a display that takes a picture seldom holds nothing up", () => {
  const page = new Page([0, 0, 0], () => true).run(2.9, { everyS: 0.7 });
  assert.ok(Math.abs(page.playout.schedule.at(2.9) - 2.9) < 1e-9);
});

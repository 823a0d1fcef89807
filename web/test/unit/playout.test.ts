// The schedule: pauses, waits of the display, speed and seeks move what is to come and nothing else.
import assert from "node:assert/strict";
import { test } from "node:test";
import { Offers } from "../../src/play/offers.ts";
import type { Playout } from "../../src/play/playout.ts";
import { playoutOf, rulesOf } from "../support/link.ts";
import { NumberTables } from "../support/offers.ts";

const SEGMENTS = 8;

/** One group of eight segments of a second, at ten frames a second; nothing takes time to decode. */
function playout(settings = {}): Playout {
  const segment = { frames: 10, bytes: [1000], psnr: [[40]] };
  const tables = new NumberTables({
    name: "one group",
    frame_rate: [10, 1],
    header_bytes: 0,
    root_bytes: 0,
    page_bytes: 0,
    qualities: ["Q0"],
    levels: [{ id: "L0", tiers: 1, pruned: 0 }],
    groups: [
      { table: 0, sidecars: [100], pictures: [[1000]], segments: Array.from({ length: SEGMENTS }, () => segment) },
    ],
  });
  const rules = { startupS: 0, resumeS: 0, decodeFrameS: 0, bufferS: 3, loops: 2, ...settings };
  return playoutOf(new Offers(tables, 0), rulesOf(rules));
}

function filled(count: number, settings = {}): Playout {
  const made = playout(settings);
  for (let position = 0; position < count; position++) made.enqueue(position, 0, 1);
  return made;
}

const on = (made: Playout, nowS: number) => {
  const found = made.at(nowS);
  return found && [found.slot.position, found.frame];
};

const deadline = (made: Playout, nowS: number) => made.deadlineS(made.dueAt(nowS), nowS);

test("what is on the screen", () => {
  const made = filled(2);
  assert.equal(on(made, 0.99), null);
  assert.deepEqual(on(made, 1.05), [0, 0]);
  assert.deepEqual(on(made, 1.75), [0, 7]);
  assert.deepEqual(on(made, 2.05), [1, 0]);
  assert.deepEqual(on(made, 9), [1, 9]); // it waits, the last picture stands
  assert.deepEqual([made.waits(2.9), made.waits(3.1), made.done(3.1)], [false, true, false]);
  assert.equal(made.bufferS(1.5), 1.5);
});

test("playing begins with enough media, and goes on with enough after a stall", () => {
  const made = playout({ startupS: 2, resumeS: 2 });
  made.enqueue(0, 0, 1);
  assert.equal(on(made, 5), null);
  made.enqueue(1, 0, 2);
  assert.deepEqual(on(made, 2), [0, 0]);
  made.enqueue(2, 0, 5.5); // due at 4
  assert.deepEqual(on(made, 6), [1, 9]);
  made.enqueue(3, 0, 6);
  assert.deepEqual(on(made, 6), [2, 0]);
  assert.deepEqual([made.stalls, made.stallS, made.slots[2].stallS], [1, 2, 2]);
});

test("a pause shifts what is to come by its length", () => {
  const made = filled(3);
  made.hold(1.5, "pause", true);
  assert.deepEqual(on(made, 100), [0, 5]);
  assert.equal(deadline(made, 100), 102.5); // as if it went on now
  assert.equal(made.earliestRequestS(3, 100), Infinity);
  made.hold(100.5, "pause", false);
  assert.deepEqual(on(made, 101.05), [1, 0]);
  assert.equal(made.startS(made.slots[2], 101), 102);
  assert.equal(made.earliestRequestS(3, 100.6), 101);
  assert.deepEqual([made.stalls, made.stallS], [0, 0]);
});

test("what arrives in a pause follows without a stall", () => {
  const made = filled(1);
  made.hold(1.5, "pause", true);
  made.enqueue(1, 0, 50);
  made.hold(60, "pause", false);
  assert.deepEqual(on(made, 60.75), [1, 2]);
  assert.equal(made.stallS, 0);
});

test("frames whose time passes in a wait for the display are missed, unless the viewer pauses", () => {
  const made = filled(3);
  made.hold(1.5, "display", true);
  made.hold(1.75, "pause", true);
  assert.deepEqual(on(made, 2), [0, 5]);
  made.hold(5.75, "pause", false);
  assert.ok(made.schedule.held);
  made.hold(6.25, "display", false);
  assert.deepEqual(on(made, 6.3), [0, 5]);
  assert.deepEqual(made.missed, { decoder: 0, display: 7 });
  made.hold(7, "display", false); // it does not wait: nothing happens
  assert.deepEqual(made.missed, { decoder: 0, display: 7 });
  assert.deepEqual([made.stalls, made.stallS], [0, 0]);
});

test("a display that waits from the start on loses no picture", () => {
  const made = playout();
  made.hold(0, "display", true);
  made.enqueue(0, 0, 3);
  made.hold(5, "display", false);
  assert.deepEqual(on(made, 5), [0, 0]);
});

test("speed", () => {
  const made = filled(3);
  made.setSpeed(1.5, 2);
  assert.deepEqual(on(made, 1.66), [0, 8]);
  assert.deepEqual(on(made, 1.775), [1, 0]);
  assert.equal(made.startS(made.slots[2], 1.5), 2.25);
  assert.equal(deadline(made, 1.5), 2.75);
  made.setSpeed(2.25, 0.5);
  assert.equal(made.startS(made.slots[2], 2.25), 2.25);
  assert.equal(deadline(made, 2.25), 4.25);
  made.enqueue(3, 0, 5.25); // due at 4.25
  assert.deepEqual([made.stalls, made.stallS], [1, 1]);
});

test("the buffer holds requests back, and makes room where it waits for more than it holds", () => {
  const made = filled(3, { startupS: 9 });
  assert.equal(on(made, 50), null);
  made.makeRoom(3);
  assert.deepEqual(on(made, 1), [0, 0]);
  assert.equal(made.earliestRequestS(3, 1), 2);
});

test("after a seek playing begins anew, within the segment that was sought", () => {
  const made = filled(3);
  made.restart(0.5);
  assert.equal(on(made, 2), null);
  assert.equal(made.last, null);
  made.enqueue(6, 0, 10);
  assert.deepEqual(on(made, 10), [6, 5]);
  made.enqueue(7, 0, 10.25);
  assert.deepEqual(on(made, 10.75), [7, 2]);
  assert.deepEqual([made.stalls, made.stallS], [0, 0]);
});

test("frames before the one that was sought are skipped, also while that is decoded", () => {
  const made = playout({ decodeFrameS: 0.25 });
  made.restart(0.5);
  for (const position of [3, 4]) made.enqueue(position, 0, 10);
  assert.deepEqual(
    made.slots.map((slot) => made.skipped(slot)),
    [5, 0],
  );
  assert.deepEqual(
    [on(made, 10), on(made, 10.5)],
    [
      [3, 5],
      [3, 7],
    ],
  );
});

test("what was cut off is fetched anew without a stall", () => {
  const made = filled(3);
  made.commit(1);
  assert.equal(made.firstFree(1.5), 2);
  made.truncate(2);
  made.enqueue(2, 0, 2.5);
  assert.deepEqual(on(made, 3.05), [2, 0]);
  assert.equal(made.stallS, 0);
});

test("what began, is lost or committed cannot be replaced", () => {
  const made = filled(3);
  made.enqueue(3, null, 1);
  made.commit(1);
  const shown = made.started(1.5).map((slot) => slot.position);
  assert.deepEqual(shown, [0]);
  assert.deepEqual(
    made.pending().map((slot) => slot.position),
    [2],
  );
});

test("what is buffered, in seconds of the sequence", () => {
  const made = playout({ bufferS: 20 });
  [0, 0, 1, null, 0, 0, 0, 0, 0].forEach((rung, position) => {
    made.enqueue(position, rung, 1);
  });
  assert.deepEqual(made.buffered(2.5), [
    { start: 1, stop: 2, rung: 0 },
    { start: 2, stop: 3, rung: 1 },
    { start: 4, stop: 8, rung: 0 },
    { start: 0, stop: 1, rung: 0 },
  ]);
});

test("the end", () => {
  const made = filled(2 * SEGMENTS);
  assert.deepEqual([made.done(16.9), made.done(17)], [false, true]);
  made.end = Infinity;
  assert.equal(made.done(17), false);
  made.finish(17);
  assert.equal(made.done(17), true);
  made.enqueue(2 * SEGMENTS, 0, 17); // the viewer wants to see it again
  assert.equal(made.done(20), false);
});

test("only the last minute is kept of an endless session", () => {
  const made = playout({ loops: Infinity });
  for (let position = 0; position < 1000; position++) {
    made.enqueue(position, 0, position);
    made.started(position);
  }
  assert.ok(made.slots.length < 70);
  assert.deepEqual(on(made, 999.05), [999, 0]);
});

test("listeners hear of changes until they leave", () => {
  const made = filled(1);
  let heard = 0;
  const leave = made.onChange(() => heard++);
  made.hold(1, "pause", true);
  made.hold(1, "pause", true); // already
  made.hold(2, "pause", false);
  made.setSpeed(2, 2);
  made.truncate(0);
  assert.equal(heard, 4);
  leave();
  made.restart();
  assert.equal(heard, 4);
});

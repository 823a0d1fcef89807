// The time of a schedule: it stands still while it is held, and never goes back.
import assert from "node:assert/strict";
import { test } from "node:test";
import { Schedule } from "../../src/play/schedule.ts";

test("a schedule passes at its speed, and stands still while there is a reason", () => {
  const schedule = new Schedule();
  assert.equal(schedule.at(2), 2);
  schedule.hold(2, "pause", true);
  schedule.hold(3, "hidden", true);
  schedule.hold(4, "pause", false);
  assert.equal(schedule.at(9), 2);
  schedule.hold(10, "hidden", false);
  schedule.setSpeed(11, 2);
  assert.equal(schedule.at(12), 5);
  assert.equal(schedule.reached(7, 12), 13);
});

test("a schedule is moved on, or stands still until it is where it was; not while it is held", () => {
  const schedule = new Schedule();
  schedule.setSpeed(10, 2);
  schedule.shift(10, 1);
  assert.equal(schedule.at(11), 13);
  schedule.shift(11, -0.5);
  assert.deepEqual([schedule.at(11), schedule.at(11.25), schedule.at(12)], [13, 13, 14.5]);
  schedule.hold(12, "pause", true);
  schedule.shift(13, 5);
  assert.equal(schedule.at(14), 14.5);
});

test("a reason from before the last change counts from that change on", () => {
  const schedule = new Schedule();
  schedule.hold(5, "hidden", true);
  schedule.hold(100, "hidden", false);
  schedule.hold(4.9, "display", true); // the last picture was drawn before the page was hidden
  assert.equal(schedule.at(101), 5);
  schedule.hold(101, "display", false);
  assert.deepEqual([schedule.at(102), schedule.missedS.display], [6, 1]);
});

// What an address says of a moment: read, written, and what is said of what it cannot mean.
import assert from "node:assert/strict";
import { test } from "node:test";
import { EARLY } from "../../src/play/playout.ts";
import { type Moment, readAddress, writeAddress } from "../../src/ui/address.ts";

const VIEW = { position: [1, -2.5, 0.001], focus: [0, 0, 3] } as const;
const MOMENTS: readonly Moment[] = [
  {},
  { t: 0 },
  { t: 1.25, view: VIEW, rung: "Q0+L1", speed: 0.5 },
  { view: { ...VIEW, up: [0, 1, 0] }, rung: "auto" },
];

for (const moment of MOMENTS) {
  test(`what is written is read again: ${writeAddress(moment)}`, () => {
    assert.deepEqual(readAddress(writeAddress(moment)), { moment, wrong: [] });
  });
}

test("it reads as people expect", () => {
  const text = writeAddress({ t: 1 / 3, view: VIEW, rung: "Q0+L1", speed: 0.5 });
  assert.equal(text, "t=0.333333333&view=1,-2.5,0.001,0,0,3&rung=Q0+L1&speed=0.5");
});

test("what others write in its place is the same", () => {
  const view = { position: [0, 0, -4], focus: [0, 0, 0], up: [0, -1, 0] };
  const { moment, wrong } = readAddress("view=0%2C0%2C-4,0,0,0,0,-2,0&rung=Q0%2BL1&t=.5");
  assert.deepEqual([moment, wrong], [{ t: 0.5, view, rung: "Q0+L1" }, []]);
});

for (const part of [
  "t=-1",
  "t=",
  "t",
  "t=Infinity",
  "t=1s",
  "speed=0",
  "speed=-1",
  "speed=fast",
  "rung=",
  "rung=%FF",
  "view=1,2,3",
  "view=1,2,3,4,5,x",
  "view=1,2,3,4,5,",
  "view=1,2,3,1,2,3",
  "view=0,0,-4,0,0,0,0,0,1",
  "view=0,0,-4,0,0,0,0,0,0",
  "time=3",
  "__proto__=1",
]) {
  test(`it is told, and the rest is read: ${part}`, () => {
    const { moment, wrong } = readAddress(`${part}&rung=Q1+L0`);
    assert.deepEqual(moment, { rung: "Q1+L0" });
    assert.equal(wrong.length, 1);
    assert.ok(wrong[0].startsWith(`${part}: expected `), wrong[0]);
  });
}

test("rounding is left out, and no frame becomes the one before", () => {
  const view = { position: [1, 0, -5.5e-17], focus: [0, 0.1 + 0.2, 0] } as const;
  assert.equal(writeAddress({ view }), "view=1,0,0,0,0.3,0");
  for (let frame = 0; frame < 100_000; frame += 997) {
    const { moment } = readAddress(writeAddress({ t: frame / 29.97 }));
    assert.equal(Math.floor(moment.t! * 29.97 + EARLY), frame);
  }
});

// The parts of the controls that need no page: figures in words, colours, the time line, the choice of the scale.
import assert from "node:assert/strict";
import { test } from "node:test";
import { pictureSize, ScaleChooser } from "../../src/ui/sharpness.ts";
import { seen } from "../../src/ui/timeline.ts";
import { clock, rampColour, rate, rungColours, size, spoken, stripes } from "../../src/ui/words.ts";

test("times read as on a clock, with hours where the whole has them", () => {
  const read = [clock(0), clock(83.9), clock(3599), clock(3600), clock(5, 7200), clock(-1), clock(Number.NaN)];
  assert.deepEqual(read, ["0:00", "1:23", "59:59", "1:00:00", "0:00:05", "0:00", "0:00"]);
  assert.deepEqual([clock(0.44, 1), clock(20.5, 21)], ["0.4 s", "0:20"]);
  assert.equal(spoken(3661), "1 hour 1 minute 1 second");
  assert.equal(spoken(0.4), "0 seconds");
});

test("rates and sizes have two digits or more, and a unit", () => {
  const read = [0, 420e3, 999e3, 2.14e6, 52.3e6, 1.2e9].map(rate);
  assert.deepEqual(read, ["–", "420 kbit/s", "999 kbit/s", "2.1 Mbit/s", "52 Mbit/s", "1.2 Gbit/s"]);
  assert.deepEqual([512, 3.14e6, 2e9].map(size), ["0.51 kB", "3.1 MB", "2.0 GB"]);
});

/** Relative luminance (WCAG 2) of "rgb(r g b)". */
function luminance(colour: string): number {
  const linear = colour.match(/\d+/g)!.map((x) => (Number(x) / 255) ** 2.2);
  return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2];
}

test("better rungs are lighter, so that hues are not needed, and all stand out from the track", () => {
  const ramp = Array.from({ length: 21 }, (_, i) => luminance(rampColour(i / 20)));
  assert.ok(ramp.every((x, i) => i === 0 || x > ramp[i - 1]));
  assert.ok((ramp[0] + 0.05) / (luminance("rgb(20 24 29)") + 0.05) > 2);
});

test("rungs are ranked by what they claim, else by their rate, in whatever order they come", () => {
  const rung = (psnr: number | null, kbps: number) => ({ name: `${kbps}`, psnr, kbps, onLadder: true });
  assert.deepEqual(rungColours([rung(40, 9), rung(30, 1), rung(35, 5)]), [1, 0, 0.5].map(rampColour));
  assert.deepEqual(rungColours([rung(null, 9), rung(null, 1)]), [1, 0].map(rampColour));
  assert.deepEqual(rungColours([rung(40, 9)]), [rampColour(1)]);
});

test("stripes leave gaps between parts, and later parts do not cover earlier ones", () => {
  const part = (start: number, stop: number, colour: string) => ({ start, stop, colour });
  assert.equal(
    stripes([part(1, 2, "red"), part(1.5, 4, "blue")], 10),
    "linear-gradient(to right, #0000 0.000% 10.000%, red 10.000% 20.000%, blue 20.000% 40.000%, #0000 40.000%)",
  );
  assert.equal(stripes([], 10), "none");
  assert.equal(stripes([part(0, 1, "red")], 0), "none");
});

test("what was seen grows with time, in its rung, and seeing it again takes its place", () => {
  let parts = [0, 0.5, 1].reduce<ReturnType<typeof seen>>((all, time) => seen(all, time, 1), []);
  assert.deepEqual(parts, [{ start: 0, stop: 1, rung: 1 }]);
  parts = seen(seen(parts, 5, 2), 5.5, 2);
  parts = seen(seen(parts, 0.2, 3), 0.6, 3);
  assert.deepEqual(
    [...parts].sort((a, b) => a.start - b.start),
    [
      { start: 0, stop: 0.2, rung: 1 },
      { start: 0.2, stop: 0.6, rung: 3 },
      { start: 0.6, stop: 1, rung: 1 },
      { start: 5, stop: 5.5, rung: 2 },
    ],
  );
});

/** A machine that needs `perPixel` milliseconds for a picture of scale 1, and `fixed` whatever the scale. */
function run(chooser: ScaleChooser, seconds: number, perPixel: number, fixed = 0): number[] {
  const scales: number[] = [];
  for (let ms = 0; ms < 1000 * seconds; ) {
    const interval = Math.max(1000 / 60, fixed + perPixel * chooser.scale ** 2);
    ms += interval;
    if (chooser.add(interval)) scales.push(chooser.scale);
  }
  return scales;
}

test("a fast machine draws all pixels, a slow one fewer, and neither goes up and down all the time", () => {
  const fast = new ScaleChooser();
  assert.deepEqual(run(fast, 60, 8), []);
  const slow = new ScaleChooser();
  assert.ok(run(slow, 60, 60).length < 12);
  assert.ok(60 * slow.scale ** 2 < 27 && slow.scale > 0.35);
  assert.ok(run(slow, 120, 60).length < 10);
});

test("it comes back when there is time again, and a machine that is far too slow ends at the least", () => {
  const chooser = new ScaleChooser();
  run(chooser, 30, 300);
  assert.equal(chooser.scale, 0.35);
  run(chooser, 120, 3);
  assert.equal(chooser.scale, 1);
});

test("a display that is slow whatever is drawn gets its pixels back", () => {
  const chooser = new ScaleChooser();
  const changes = run(chooser, 40, 1, 33);
  assert.equal(chooser.scale, 1);
  assert.ok(changes.length <= 4);
});

test("a page that was hidden for a while is no reason for fewer pixels", () => {
  const chooser = new ScaleChooser();
  assert.ok(Array.from({ length: 200 }, (_, i) => chooser.add(i % 20 ? 16 : 9000)).every((changed) => !changed));
});

test("pictures have whole pixels, at most two a CSS pixel in each direction, and at least one", () => {
  assert.deepEqual(pictureSize(640, 360, 3, 1), [1280, 720]);
  assert.deepEqual(pictureSize(333, 200, 1, 0.35), [117, 70]);
  assert.deepEqual(pictureSize(0.2, 0, 1, 0.35), [1, 1]);
});

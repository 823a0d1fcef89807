// Which way is up, as a package tells it: what is refused, and what players make of it.
import assert from "node:assert/strict";
import { test } from "node:test";
import { firstView, isSimilarity, levelled, upOf, upright } from "../../src/format/region.ts";
import type { Region, Root, World } from "../../src/format/types.ts";
import { Orbit } from "../../src/ui/orbit.ts";

const worldOf = (...transform: number[]): World => ({ transform, metric: false });
const Z_UP = worldOf(2, 0, 0, 1, 0, 0, 2, 1, 0, -2, 0, 1);
const REGION: Region = {
  source: "cameras",
  width: 160,
  height: 90,
  fov_y: 40,
  near: 0.1,
  turn: 10,
  places: [{ position: [0, -4, 0.5], focus: [0, 0, 0], up: [0.3, 0, 1], reach: 1 }],
};

test("a similarity may stand, and says which way is up", () => {
  assert.ok(isSimilarity(Z_UP));
  assert.deepEqual(upOf(Z_UP), [0, 0, 1]);
  assert.ok(isSimilarity(worldOf(...Z_UP.transform.map((value) => Math.fround(value * 0.123)))));
});

test("stretches, shears, mirrors and scales of nothing are refused", () => {
  assert.ok(!isSimilarity(worldOf(1, 0, 0, 0, 0, 2, 0, 0, 0, 0, 1, 0)));
  assert.ok(!isSimilarity(worldOf(1, 0.01, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0)));
  assert.ok(!isSimilarity(worldOf(1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 0)));
  assert.ok(!isSimilarity(worldOf(...Array.from({ length: 12 }, () => 0))));
  const third = [2 / 3, -1 / 3, 2 / 3, 0, 2 / 3, 2 / 3, -1 / 3, 0, -1 / 3, 2 / 3, 2 / 3, 0];
  for (const scale of [1e6, 1e-6, 1e6 * (1 + 1e-9), 1e-6 * (1 - 1e-9)]) {
    assert.ok(isSimilarity(worldOf(...third.map((value) => scale * value))), "rounding at the bounds is forgiven");
  }
  for (const scale of [1e7, 1e-7]) assert.ok(!isSimilarity(worldOf(scale, 0, 0, 0, 0, scale, 0, 0, 0, 0, scale, 0)));
});

test("a viewer is upright as the package tells, whatever the places say, and turns about that axis", () => {
  const bare = { region: REGION } as Root;
  assert.equal(levelled(bare), REGION);
  const told = levelled({ ...bare, world: Z_UP });
  assert.deepEqual(upright(told), [0, 0, 1]);
  assert.ok(Math.abs(firstView(told).up[0]!) < 1e-12);
  const orbit = Object.assign(new Orbit(told), { free: true });
  orbit.move({ right: 1 });
  const { position, up } = orbit.view(16 / 9);
  assert.ok(Math.abs(position[2]! - 0.5) < 1e-9, "as high as before");
  assert.ok(up[2]! > 0.9);
});

test("a viewer who looks straight down has an up, too", () => {
  const above = { ...REGION, places: [{ ...REGION.places[0]!, position: [0, 0, 4] }] };
  const { up } = firstView(levelled({ region: above, world: Z_UP } as Root));
  assert.ok(Math.abs(Math.hypot(...up) - 1) < 1e-12 && Math.abs(up[2]!) < 1e-12);
});

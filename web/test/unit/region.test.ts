import assert from "node:assert/strict";
import { test } from "node:test";
import { firstView, keepInside, nearest, upright } from "../../src/format/region.ts";
import type { Region } from "../../src/format/types.ts";
import { readVectors } from "./files.ts";

const isInside = ({ distance, degrees }: { distance: number; degrees: number }) => distance === 0 && degrees === 0;

const regionOf = (turn: number, places: Region["places"]): Region => ({
  source: "file",
  width: 64,
  height: 64,
  fov_y: 50,
  near: 0.1,
  turn,
  places,
});
const length = (v: readonly number[]) => Math.hypot(...v);
const minus = (a: readonly number[], b: readonly number[]) => a.map((x, i) => x - b[i]!);

for (const { name, turn, places, viewers } of readVectors("region").cases) {
  const region = regionOf(turn, places);

  test(`region: ${name}`, () => {
    for (const { position, forward, distance, degrees, inside } of viewers) {
      const found = nearest(region, { position, forward }).departure;
      assert.ok(Math.abs(found.distance - distance) <= 1e-6, `distance ${found.distance}, expected ${distance}`);
      assert.ok(Math.abs(found.degrees - degrees) <= 1e-3, `degrees ${found.degrees}, expected ${degrees}`);
      assert.equal(isInside(found), inside);
    }
  });

  test(`region keeps viewers inside: ${name}`, () => {
    for (const { position, forward, distance, inside } of viewers) {
      const kept = keepInside(region, position, forward);
      assert.ok(isInside(nearest(region, kept).departure), `${position} is kept at ${kept.position}`);
      assert.ok(Math.abs(length(kept.forward) - 1) < 1e-6);
      assert.ok(Math.abs(length(minus(kept.position, position)) - distance) <= 1e-6 * (1 + distance));
      if (inside) assert.deepEqual(kept, { position, forward });
    }
  });

  test(`the first view of a region is inside: ${name}`, () => {
    const { position, forward, up, fovY } = firstView(region);
    assert.ok(isInside(nearest(region, { position, forward }).departure));
    assert.ok(Math.abs(length(up) - 1) < 1e-9);
    assert.ok(Math.abs(up.reduce((sum, x, i) => sum + x * forward[i]!, 0)) < 1e-9);
    assert.equal(fovY, 50);
  });
}

test("a viewer who looks away is turned as little as it takes", () => {
  const region = regionOf(10, [{ position: [0, 0, 0], focus: [0, 0, 5], up: [0, -1, 0], reach: 0 }]);
  const { forward } = keepInside(region, [0, 0, 0], [Math.sin(0.5), 0, Math.cos(0.5)]);
  const turn = (10 * Math.PI) / 180;
  [Math.sin(turn), 0, Math.cos(turn)].forEach((x, i) => {
    assert.ok(Math.abs(forward[i]! - x) < 1e-12);
  });
  const behind = keepInside(region, [0, 0, 0], [0, 0, -1]);
  assert.ok(Math.abs(behind.forward[2]! - Math.cos(turn)) < 1e-12, "any side will do");
});

test("the up of a place may be along its view", () => {
  const region = regionOf(0, [{ position: [0, 0, 0], focus: [0, 3, 0], up: [0, 2, 0], reach: 0 }]);
  const { up } = firstView(region);
  assert.ok(Math.abs(up[1]!) < 1e-12 && Math.abs(length(up) - 1) < 1e-12);
});

test("up is level in the pictures of all places, whichever way they look down", () => {
  const places = [70, 50, 24, 16, -20].map((degrees, i) => {
    const pitch = (degrees * Math.PI) / 180;
    const [x, z] = [Math.cos(2.4 * i), Math.sin(2.4 * i)];
    const view = [x * Math.cos(pitch), -Math.sin(pitch), z * Math.cos(pitch)];
    const up = [2 * x * Math.sin(pitch), 2 * Math.cos(pitch), 2 * z * Math.sin(pitch)];
    return { position: view.map((a) => -3 * a), focus: [0, 0, 0], up, reach: 0.5 };
  });
  const region: Region = { ...regionOf(0, places), source: "found" };
  assert.ok(Math.hypot(...minus(upright(region), [0, 1, 0])) < 1e-3);
  assert.deepEqual(firstView(region).position, places[0]!.position);
});

test("places around a scene, each with the up of its picture, agree on where up is", () => {
  const tilt = (degrees: number) => [Math.sin((degrees * Math.PI) / 180), Math.cos((degrees * Math.PI) / 180), 0];
  const from = (degrees: number) => ({ position: [-5, 0, 0], focus: [0, 0, 0], up: tilt(degrees), reach: 0 });
  const near = (found: readonly number[], expected: readonly number[]) =>
    found.every((x, i) => Math.abs(x - expected[i]!) < 1e-12);
  assert.ok(near(upright(regionOf(0, [from(70), from(-70)])), [0, 1, 0]));
  assert.ok(near(upright(regionOf(0, [from(10), from(190)])), tilt(10)), "they do not: the first");
});

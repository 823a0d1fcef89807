// Where somebody with a headset on sits, how large the scene is around him, and what his eyes see.
import assert from "node:assert/strict";
import { test } from "node:test";
import type { Camera, Root, World } from "../../src/format/types.ts";
import { eyeCamera, seatOf, viewFrom } from "../../src/play/seat.ts";

/** z is up; the subject is 5 units ahead, 3 of them down. */
const REGION: Root["region"] = {
  source: "cameras",
  width: 160,
  height: 90,
  fov_y: 40,
  near: 0.1,
  turn: 10,
  places: [{ position: [1, -4, 3], focus: [1, 0, 0], up: [0, 0, 1], reach: 1 }],
};
/** A unit is half a metre, and (0, 1, 0) of the scene is −z of the world. */
const WORLD: World = { transform: [0.5, 0, 0, 7, 0, 0, 0.5, 8, 0, -0.5, 0, 9], metric: true };
const rootOf = (world?: World) => ({ region: REGION, ...(world && { world }) }) as Root;

/** A pose of the room that is turned by `radians` to the left. */
function pose([x, y, z]: readonly number[], radians = 0): Float32Array {
  const [c, s] = [Math.cos(radians), Math.sin(radians)];
  return Float32Array.from([c, 0, -s, 0, 0, 1, 0, 0, s, 0, c, 0, x!, y!, z!, 1]);
}

/** Sides of a picture as tangents -> the matrix of WebXR. */
const lens = (left: number, right: number, down: number, up: number): Float32Array => {
  const [width, height] = [right - left, up - down];
  const middle = [(right + left) / width, (up + down) / height];
  return Float32Array.from([2 / width, 0, 0, 0, 0, 2 / height, 0, 0, ...middle, -1, -1, 0, 0, -0.2, 0]);
};

function assertNear(found: ArrayLike<number>, expected: readonly number[]): void {
  assert.equal(found.length, expected.length);
  expected.forEach((value, i) => {
    assert.ok(Math.abs(found[i]! - value) < 1e-5, `${Array.from(found)}, expected ${expected}`);
  });
}

/** Where a camera shows a point of the scene, pixels. */
function seen({ worldToCamera: m, fx, fy, cx, cy }: Camera, [x, y, z]: readonly number[]): [number, number] {
  const line = (i: number) => m[4 * i]! * x! + m[4 * i + 1]! * y! + m[4 * i + 2]! * z! + m[4 * i + 3]!;
  return [(fx * line(0)) / line(2) + cx, (fy * line(1)) / line(2) + cy];
}

test("who sits down is at the first view, upright and level, the subject ahead", () => {
  const view = viewFrom(seatOf(rootOf()), pose([0, 0, 0]));
  assertNear(view.position, [1, -4, 3]);
  assertNear(view.forward, [0, 1, 0]);
  assertNear(view.up, [0, 0, 1]);
});

test("where nobody told which way is up, a steep first view is straight ahead", () => {
  const places = [{ ...REGION.places[0]!, position: [1, -1, 4], up: [0, 1, 0.1] }];
  const others = [...Array(8)].map(() => REGION.places[0]!);
  const seated = (world?: World) => {
    const root = { ...rootOf(world), region: { ...REGION, places: [...places, ...others] } };
    return viewFrom(seatOf(root), pose([0, 0, 0]));
  };
  assertNear(seated().forward, [0, 1 / Math.sqrt(17), -4 / Math.sqrt(17)]);
  assertNear(seated(WORLD).forward, [0, 1, 0]);
});

test("a scene has its real size where the package tells it, else its subject is 1.5 m away", () => {
  assert.equal(seatOf(rootOf(WORLD)).metre, 2);
  for (const root of [rootOf(), rootOf({ ...WORLD, metric: false })]) assert.equal(seatOf(root).metre, 5 / 1.5);
});

test("a step in the room is a step in the scene", () => {
  const seat = seatOf(rootOf(WORLD));
  const view = viewFrom(seat, pose([0.5, 0.25, -1], Math.PI / 2));
  assertNear(view.position, [1 + 1, -4 + 2, 3 + 0.5]); // right, ahead, up
  assertNear(view.forward, [-1, 0, 0]); // to the left
  assertNear(view.up, [0, 0, 1]);
});

test("an eye's picture reaches as far to each side as its lens", () => {
  const camera = eyeCamera(seatOf(rootOf(WORLD)), pose([0, 0, 0]), lens(-1.5, 0.5, -1, 0.6), 200, 80);
  assertNear([camera.fx, camera.fy, camera.cx, camera.cy], [100, 50, 150, 30]);
  const at = ([right, up]: readonly number[]) => [1 + 2 * right!, -4 + 2, 3 + 2 * up!]; // a metre ahead
  assertNear(seen(camera, at([-1.5, 0.6])), [0, 0]);
  assertNear(seen(camera, at([0.5, -1])), [200, 80]);
});

test("what is near moves more between the eyes", () => {
  const seat = seatOf(rootOf(WORLD));
  const shift = (metres: number) => {
    const point = [1, -4 + 2 * metres, 3];
    const [left, right] = [-0.03, 0.03].map((x) => {
      return seen(eyeCamera(seat, pose([x, 0, 0]), lens(-1, 1, -1, 1), 100, 100), point)[0];
    });
    return left! - right!;
  };
  assertNear([shift(1), shift(3)], [50 * 0.06, (50 * 0.06) / 3]); // focal length · 6 cm / distance
});

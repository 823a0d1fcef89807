// Camera paths: read, and what lies between keyframes.
import assert from "node:assert/strict";
import { test } from "node:test";
import { CameraPath, readCameraPath } from "../../src/play/keyframes.ts";
import { readJson } from "./files.ts";

const UP = [0, -1, 0] as const;
const FIRST = { t: 0, position: [0, 0, -4], focus: [0, 0, 0] };
const PICTURE = { camera_to_world: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1], fov: 50 };

for (const { name, path: data, up, fov_y, duration, views } of readJson("tests/data/camera_paths.json").cases) {
  test(`the views of the path "${name}" are those of the vectors`, () => {
    const path = readCameraPath(data, up, fov_y);
    assert.equal(path.duration, duration);
    for (const [seconds, ...view] of views) {
      const off = path.at(seconds).map((x, i) => Math.abs(x - view[i]));
      assert.ok(Math.max(...off) < 1e-9, `${seconds} s: ${off}`);
    }
  });
}

test("a loop that closes is smooth where it does", () => {
  const path = new CameraPath([0, 1, 2], [[0], [3], [0]], true);
  const [before, at, after] = [1.999, 2, 2.001].map((seconds) => path.at(seconds)[0]);
  assert.ok(Math.abs(at - before - (after - at)) < 1e-4);
});

const REFUSED: [data: object, words: RegExp][] = [
  [{}, /expected keyframes/],
  [{ keyframes: [] }, /no keyframe/],
  [{ keyframes: [FIRST, FIRST] }, /begin at 0 and ascend/],
  [{ keyframes: [{ ...FIRST, t: 2 }] }, /begin at 0 and ascend/],
  [{ keyframes: [FIRST], loop: 1 }, /loop is true or false/],
  [{ keyframes: [{ ...FIRST, focus: [0, 0, -4] }] }, /keyframe 0 looks nowhere/],
  [{ keyframes: [{ ...FIRST, up: [0, 0, 1] }] }, /keyframe 0 looks nowhere/],
  [{ keyframes: [{ ...FIRST, focus: [0, 0] }] }, /not three numbers/],
  [{ keyframes: [{ ...FIRST, position: [0, 0, "4"] }] }, /no finite number/],
  [{ keyframes: [{ ...FIRST, fov_y: 180 }] }, /fov_y of 180/],
  [{ keyframes: [{ ...FIRST, fov: 40 }] }, /fov, which means nothing/],
  [{ camera_path: [PICTURE, PICTURE], fps: 0 }, /no finite number/],
  [{ camera_path: [{ ...PICTURE, camera_to_world: [1, 2] }], fps: 1 }, /not 16 numbers/],
];

test("what is no path is refused", () => {
  for (const [data, words] of REFUSED) assert.throws(() => readCameraPath({ ...data }, UP, 50), words);
});

// The camera without a page: where it goes, that it stays inside, and that it comes to rest.
import assert from "node:assert/strict";
import { test } from "node:test";
import type { Region } from "../../src/format/types.ts";
import { angle, cross, dot, length, minus, turned, unit, type Vector } from "../../src/format/vector.ts";
import { CameraPath } from "../../src/play/keyframes.ts";
import { Orbit, rubber, softened } from "../../src/ui/orbit.ts";

const REGION: Region = {
  source: "cameras",
  width: 1600,
  height: 900,
  fov_y: 40,
  near: 0.1,
  turn: 10,
  places: [{ position: [0, 0, -4], focus: [0, 0, 0], up: [0, -2, 0], reach: 1 }],
};
const RING: Region = {
  ...REGION,
  places: [0, 1, 2, 3, 4, 5].map((i) => ({
    position: [4 * Math.sin(i), 0, -4 * Math.cos(i)],
    focus: [0.1 * i, 0, 0],
    up: [0, -1, 0],
    reach: 2.2,
  })),
};
const ASPECT = 16 / 9;
const free = (region = REGION) => Object.assign(new Orbit(region), { free: true });
const close = (a: Vector, b: Vector, within = 1e-9) => assert.ok(length(minus(a, b)) < within, `${a} is not ${b}`);

function settle(orbit: Orbit): number {
  let steps = 0;
  while (orbit.step(1 / 60) && steps < 2000) steps++;
  return steps;
}

test("it starts at the first place, with the lens of the region and a direction of length 1 up", () => {
  const view = new Orbit(REGION).view(ASPECT);
  assert.deepEqual(view, { position: [0, 0, -4], forward: [0, 0, 1], up: [0, -1, 0], fovY: 40, near: 0.1 });
});

test("a picture is as high as those of the region, and where it is narrower than high, as wide as they are high", () => {
  const wide = (fov: number, aspect: number) => Math.tan((fov * Math.PI) / 360) * aspect;
  const orbit = new Orbit(REGION);
  assert.equal(orbit.view(1.2).fovY, 40);
  assert.ok(Math.abs(wide(orbit.view(0.5).fovY, 0.5) - wide(40, 1)) < 1e-9);
  assert.equal(orbit.view(3).fovY, 40);
  assert.ok(orbit.view(0.2).fovY <= 100);
});

test("turning right goes right about the focus: as far away, looking at it, upright", () => {
  const orbit = free();
  orbit.move({ right: 0.5 });
  const { position, forward, up } = orbit.view(ASPECT);
  close(position, [4 * Math.sin(0.5), 0, -4 * Math.cos(0.5)]);
  close(forward, unit(minus([0, 0, 0], position)));
  close(up, [0, -1, 0]);
});

test("turning up goes up, against y, and never over the top", () => {
  const orbit = free();
  orbit.move({ up: 0.3 });
  close(orbit.view(ASPECT).position, [0, -4 * Math.sin(0.3), -4 * Math.cos(0.3)]);
  for (let i = 0; i < 20; i++) orbit.move({ up: 0.3 });
  const { position, forward, up } = orbit.view(ASPECT);
  assert.ok(Math.abs(Math.asin(dot(forward, [0, 1, 0])) - 1.5) < 1e-6);
  assert.ok(Math.abs(length(position) - 4) < 1e-9 && Math.abs(dot(up, forward)) < 1e-9);
});

test("panning moves what is looked at along with the viewer; zooming is by shares of the distance", () => {
  const orbit = free();
  orbit.move({ panRight: 0.25 });
  const high = 2 * 4 * Math.tan((orbit.view(1).fovY * Math.PI) / 360);
  close(orbit.view(ASPECT).position, [0.25 * high, 0, -4]);
  close(orbit.view(ASPECT).forward, [0, 0, 1]);
  orbit.move({ nearer: Math.log(2) });
  close(orbit.view(ASPECT).position, [0.25 * high, 0, -2]);
  for (let i = 0; i < 100; i++) orbit.move({ nearer: 1 });
  assert.ok(length(minus(orbit.view(ASPECT).position, [0.25 * high, 0, 0])) > 0.01);
});

test("what is nudged or flung comes to rest; a nudge goes as far as it says", () => {
  for (const reduced of [false, true]) {
    const orbit = free();
    orbit.reduced = reduced;
    orbit.nudge({ nearer: 0.5 });
    assert.ok(settle(orbit) < 300);
    assert.ok(Math.abs(orbit.view(ASPECT).position[2] + 4 * Math.exp(-0.5)) < 0.01);
    orbit.fling({ right: 2 });
    assert.equal(settle(orbit) === 0, reduced);
    assert.equal(orbit.moving, false);
  }
});

test("a driven camera goes on until it is let go", () => {
  const orbit = free();
  orbit.drive({ right: 1 });
  for (let i = 0; i < 60; i++) assert.ok(orbit.step(1 / 60));
  assert.ok(Math.abs(angle(orbit.view(ASPECT).forward, [0, 0, 1]) - 1) < 1e-6);
  orbit.drive({});
  assert.ok(settle(orbit) > 0 && !orbit.moving);
});

test("the wall gives way a little, with growing resistance, and lets nobody stay outside", () => {
  const orbit = new Orbit(REGION);
  orbit.held = true;
  const out: number[] = [];
  for (let i = 0; i < 12; i++) {
    orbit.move({ right: 0.1 });
    orbit.step(1 / 60);
    out.push(length(minus(orbit.view(ASPECT).position, [0, 0, -4])) - 1);
  }
  assert.ok(out.at(-1)! > 0.05 && out.at(-1)! < 0.15 * 4);
  const steps = out.slice(4).map((x, i) => x - out[i + 3]);
  assert.ok(steps.every((x, i) => x > 0 && (i === 0 || x < steps[i - 1] + 1e-3)));
  assert.ok(orbit.strain > 0.2 && orbit.strain < 1);
  orbit.held = false;
  assert.ok(settle(orbit) < 600);
  const { position, forward } = orbit.view(ASPECT);
  assert.ok(length(minus(position, [0, 0, -4])) <= 1 + 1e-9);
  assert.ok(angle(forward, unit(minus([0, 0, 0], position))) <= (10 * Math.PI) / 180 + 1e-9);
  assert.equal(orbit.outside, false);
});

test("who may leave leaves, and is brought back when he may not any more, without a jump", () => {
  const orbit = new Orbit(REGION);
  orbit.setFree(true);
  settle(orbit);
  orbit.move({ right: 2 });
  assert.ok(orbit.outside && length(minus(orbit.view(ASPECT).position, [0, 0, -4])) > 4);
  const before = orbit.view(ASPECT).position;
  orbit.setFree(false);
  close(orbit.view(ASPECT).position, before);
  settle(orbit);
  assert.equal(orbit.outside, false);
});

test("a way round a ring of places turns about the focus of the nearest, and no step of it is a jump", () => {
  const orbit = new Orbit(RING);
  let before = orbit.view(ASPECT).position;
  for (let i = 0; i < 150; i++) {
    orbit.move({ right: 0.02 });
    orbit.step(1 / 60);
    const { position } = orbit.view(ASPECT);
    assert.ok(length(minus(position, before)) < 0.3, `step ${i}`);
    before = position;
  }
  settle(orbit);
  assert.equal(orbit.outside, false);
  assert.ok(length(minus(orbit.view(ASPECT).position, [0, 0, -4])) > 3);
});

test("back to the first view glides there, from anywhere", () => {
  const orbit = free();
  orbit.move({ right: 3, up: 0.4 });
  orbit.move({ panUp: 0.3, nearer: 0.7 });
  const before = orbit.view(ASPECT);
  orbit.reset();
  close(orbit.view(ASPECT).position, before.position, 1e-6);
  assert.ok(settle(orbit) > 10);
  assert.deepEqual(orbit.view(ASPECT), new Orbit(REGION).view(ASPECT));
});

test("without a region it can be turned all the same", () => {
  const orbit = new Orbit();
  orbit.move({ right: 1, nearer: 0.1 });
  assert.ok(Number.isFinite(length(orbit.view(1).position)) && !orbit.outside);
});

test("a region without reach still gives way, and a viewer at the focus may look anywhere", () => {
  const point: Region = { ...REGION, places: [{ ...REGION.places[0], reach: 0 }] };
  const orbit = new Orbit(point);
  orbit.held = true;
  orbit.move({ right: 0.2 });
  const out = length(minus(orbit.view(ASPECT).position, [0, 0, -4]));
  assert.ok(out > 0.1 && out < 0.6);
  const there: Region = { ...REGION, places: [{ ...REGION.places[0], reach: 9 }] };
  const pose = { position: [0, 0, 0], forward: [1, 0, 0] } as const;
  assert.deepEqual(softened(there, pose, [0, 0, 0]), { ...pose, strain: 0 });
});

test("inside, the wall does nothing; outside, pulled and held back point the same way", () => {
  const pose = { position: [0.3, 0.2, -4.1], forward: unit([0, 0.02, 1]) } as const;
  assert.deepEqual(softened(REGION, pose, [0, 0, 0]), { ...pose, strain: 0 });
  const far = softened(REGION, { position: [0, -9, -4], forward: [0, 0, 1] }, [0, 0, 0]);
  assert.ok(far.position[1] < -1 && far.position[1] > -1.6 && far.position[0] === 0);
  assert.ok(far.strain > 0.9 && far.strain < 1);
  assert.equal(rubber(0, 1), 0);
  assert.ok(rubber(1e9, 2) < 2 && Math.abs(rubber(1e-6, 2) - 1e-6) < 1e-11);
});

test("vectors turn as the right hand does", () => {
  close(turned([1, 0, 0], [0, 0, 1], Math.PI / 2), [0, 1, 0]);
  close(cross([1, 0, 0], [0, 1, 0]), [0, 0, 1]);
});

test("a stance that is taken again is the same view, wherever it was", () => {
  for (const region of [REGION, RING]) {
    const orbit = free(region);
    orbit.move({ right: 0.4, up: 0.2, panRight: 0.1, nearer: 0.3 });
    orbit.turnOver();
    settle(orbit);
    const other = free(region);
    other.begin(orbit.stance);
    settle(other);
    const [seen, again] = [orbit.view(ASPECT), other.view(ASPECT)];
    for (const axis of ["position", "forward", "up"] as const) close(again[axis], seen[axis]);
    other.move({ right: 1 });
    other.reset();
    settle(other);
    close(other.view(ASPECT).position, seen.position);
    other.begin(null);
    settle(other);
    assert.deepEqual(other.view(ASPECT), new Orbit(region).view(ASPECT));
  }
});

test("turned over, up is down and a step to the right is still one to the right of the picture", () => {
  const orbit = free();
  orbit.turnOver();
  const before = orbit.view(ASPECT);
  close(before.up, [0, 1, 0]);
  close(orbit.stance.up!, [0, 1, 0]);
  orbit.move({ right: 0.1 });
  const step = minus(orbit.view(ASPECT).position, before.position);
  assert.ok(dot(step, cross(before.forward, before.up)) > 0);
  orbit.turnOver();
  assert.equal(orbit.stance.up, undefined);
});

const PATH = new CameraPath(
  [0, 2],
  [
    [0, 0, -4, 0, 0, 0, 0, -1, 0, 30],
    [0.5, 0, -4, 0, 0, 0, 0, -1, 0, 20],
  ],
  false,
);

test("it goes along a path as the scene is played, and stays at its end", () => {
  const orbit = new Orbit(REGION);
  orbit.follow(() => PATH);
  assert.equal(orbit.view(ASPECT).fovY, 30);
  assert.ok(!orbit.step(1 / 60));
  for (const x of [0.25, 0.5, 0.5]) {
    assert.ok(orbit.step(1 / 60, 1));
    close(orbit.view(ASPECT).position, [x, 0, -4]);
  }
  assert.equal(orbit.view(ASPECT).fovY, 20);
});

test("whoever touches the camera has it: the path is over, where the camera is", () => {
  const touches: Record<string, (orbit: Orbit) => void> = {
    finger: (orbit) => orbit.stop(),
    wheel: (orbit) => orbit.nudge({ nearer: 0 }),
    key: (orbit) => orbit.drive({ right: 1e-9 }),
  };
  for (const touch of Object.values(touches)) {
    const orbit = new Orbit(REGION);
    orbit.follow(() => PATH);
    orbit.step(1 / 60, 1);
    touch(orbit);
    orbit.step(1 / 60, 1);
    close(orbit.view(ASPECT).position, [0.25, 0, -4], 1e-6);
    assert.equal(orbit.view(ASPECT).fovY, 25);
    orbit.drive({});
    orbit.reset();
    assert.equal(orbit.view(ASPECT).fovY, 40);
  }
});

test("where people want no motion, a path is its first view", () => {
  const orbit = Object.assign(new Orbit(REGION), { reduced: true });
  orbit.follow(() => PATH);
  orbit.step(1, 1);
  close(orbit.view(ASPECT).position, [0, 0, -4]);
});

test("a path out of the region meets its wall, unless viewers may leave", () => {
  const away = new CameraPath([0], [[9, 0, -4, 0, 0, 0, 0, -1, 0, 30]], false);
  const [bounded, out] = [new Orbit(REGION), free()];
  for (const orbit of [bounded, out]) orbit.follow(() => away);
  assert.ok(bounded.view(ASPECT).position[0] < 2);
  close(out.view(ASPECT).position, [9, 0, -4]);
});

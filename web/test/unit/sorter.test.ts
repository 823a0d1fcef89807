// Requests for orders: which are made, which are overtaken. A worker that answers when it is told to stands in.
import assert from "node:assert/strict";
import { test } from "node:test";
import type { SortRequest } from "../../src/render/sort.ts";
import { Sorter } from "../../src/render/sorter.ts";

const CAMERA = {
  width: 8,
  height: 8,
  fx: 8,
  fy: 8,
  cx: 4,
  cy: 4,
  near: 0.01,
  worldToCamera: Float64Array.of(1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1),
};
const MEANS = Float32Array.of(1, 2, 3);

function pair() {
  const asked: SortRequest[] = [];
  const worker = {
    ended: false,
    onmessage: (_event: { data: Uint32Array | null }) => {},
    onerror: (_event: { message: string }) => {},
    postMessage: (request: SortRequest) => asked.push(request),
    terminate: () => {
      worker.ended = true;
    },
  };
  const failures: string[] = [];
  const sorter = new Sorter(worker as unknown as Worker, (why) => failures.push(why));
  return { asked, worker, sorter, failures, answer: (row: number) => worker.onmessage({ data: Uint32Array.of(row) }) };
}

test("one request is made at a time, and the newest one that waits is next", async () => {
  const { asked, sorter, answer } = pair();
  const [first, second, third] = [1, 2, 3].map((depth) => sorter.order(Float32Array.of(0, 0, depth), "a", CAMERA));
  assert.equal(asked.length, 1);
  assert.equal(await second, null);
  answer(7);
  assert.deepEqual(await first, Uint32Array.of(7));
  assert.deepEqual(
    asked.map(({ means }) => means?.[2]),
    [1, 3],
  );
  answer(8);
  assert.deepEqual(await third, Uint32Array.of(8));
});

test("means of a request that was overtaken are not lost", async () => {
  const { asked, sorter, answer } = pair();
  void sorter.order(null, "a", CAMERA);
  const overtaken = sorter.order(MEANS, "a", CAMERA);
  void sorter.order(null, "a", CAMERA);
  answer(0);
  assert.equal(await overtaken, null);
  assert.equal(asked[1].means, MEANS);
});

test("requests of two scenes do not overtake each other", async () => {
  const { asked, sorter, answer } = pair();
  void sorter.order(MEANS, "a", CAMERA);
  const [old, next] = [sorter.order(MEANS, "a", CAMERA), sorter.order(MEANS, "b", CAMERA)];
  answer(0);
  answer(1);
  answer(2);
  assert.deepEqual([await old, await next], [Uint32Array.of(1), Uint32Array.of(2)]);
  assert.deepEqual(
    asked.map(({ key }) => key),
    ["a", "a", "b"],
  );
});

test("a worker that fails answers null and does not block the next request; why is told until it has worked", async () => {
  const { worker, sorter, answer, failures } = pair();
  const failed = sorter.order(MEANS, "a", CAMERA);
  const next = sorter.order(MEANS, "b", CAMERA);
  worker.onerror({ message: "no memory" });
  assert.equal(await failed, null);
  answer(3);
  assert.deepEqual(await next, Uint32Array.of(3));
  worker.onerror({ message: "a bad request" });
  assert.deepEqual(failures, ["no memory"]);
});

test("forgetting and closing leave nobody waiting", async () => {
  const { asked, worker, sorter } = pair();
  const sorting = sorter.order(MEANS, "a", CAMERA);
  const forgotten = sorter.order(MEANS, "b", CAMERA);
  sorter.forget("b");
  assert.deepEqual(asked[1], { key: "b", means: null, view: null });
  assert.equal(await forgotten, null);
  const waiting = sorter.order(MEANS, "c", CAMERA);
  sorter.close();
  assert.deepEqual([await sorting, await waiting, await sorter.order(MEANS, "d", CAMERA)], [null, null, null]);
  assert.ok(worker.ended);
});

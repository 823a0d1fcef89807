// What of the media part needs no browser: how much is kept, how far decoding goes ahead, errors between threads.
import assert from "node:assert/strict";
import { mock, test } from "node:test";
import { Recent } from "../../src/format/collections.ts";
import { FormatError } from "../../src/format/errors.ts";
import { LEAST_BYTES, TIMEOUT_S } from "../../src/generated/constants.ts";
import { Ahead } from "../../src/media/bell.ts";
import { aborted, fromWire, TransportError, toWire, UnsupportedError } from "../../src/media/errors.ts";
import { checkReprDigest, FileClient } from "../../src/media/http.ts";
import { buffersOf } from "../../src/media/messages.ts";

const storeOf = (most: number) => new Recent<string, Uint8Array>(most, (bytes) => bytes.length);

test("the files used least lately go first", () => {
  const store = storeOf(100);
  for (const path of ["a", "b", "c"]) store.set(path, new Uint8Array(30));
  assert.equal(store.get("a")?.length, 30);
  store.set("d", new Uint8Array(30));
  assert.deepEqual(
    ["a", "b", "c", "d"].map((path) => store.get(path) !== undefined),
    [true, false, true, true],
  );
  store.set("d", new Uint8Array(10));
  store.set("e", new Uint8Array(30)); // 100 in all
  assert.notEqual(store.get("a"), undefined);
  store.set("f", new Uint8Array(1));
  assert.equal(store.get("c"), undefined);
});

test("a file larger than the store is kept alone", () => {
  const store = storeOf(100);
  store.set("small", new Uint8Array(10));
  store.set("large", new Uint8Array(1000));
  assert.equal(store.get("small"), undefined);
  assert.equal(store.get("large")?.length, 1000);
});

/** Whether a promise is kept by now. */
async function isKept(promise: Promise<void>): Promise<boolean> {
  const late = new Promise<boolean>((resolve) => setTimeout(() => resolve(false), 5));
  return Promise.race([promise.then(() => true), late]);
}

test("pictures wait for those ahead, segments for those before", async () => {
  const ahead = new Ahead(100, 2);
  const { signal } = new AbortController();
  ahead.give(1, 0, 60);
  assert.ok(await isKept(ahead.room(1, signal)));
  ahead.give(2, 0, 60);
  const room = ahead.room(2, signal);
  const place = ahead.place(signal);
  assert.deepEqual([await isKept(room), await isKept(place)], [false, false]);
  ahead.taken(2, 0);
  ahead.taken(2, 0); // twice is once
  assert.deepEqual([await isKept(room), await isKept(place)], [true, true]);
  ahead.give(2, 1, 60);
  assert.deepEqual([await isKept(ahead.room(1, signal)), await isKept(ahead.room(3, signal))], [false, true]);
  ahead.drop(1);
  assert.ok(await isKept(ahead.room(2, signal)));
});

test("who gave up waits no longer", async () => {
  const ahead = new Ahead(1, 1);
  ahead.give(1, 0, 1);
  const stop = new AbortController();
  const waiting = ahead.room(1, stop.signal);
  assert.ok(!(await isKept(waiting)));
  stop.abort();
  assert.ok(await isKept(waiting));
});

test("errors keep their class and their reason between threads", () => {
  const errors = [
    new FormatError("bad_picture", "keyframe/T0/Q0/1.m4s", "expected one, got two"),
    new TransportError("no server"),
    new UnsupportedError("no WebCodecs"),
    aborted(),
    new RangeError("segment 9"),
  ];
  for (const error of errors) {
    const got = fromWire(structuredClone(toWire(error)));
    assert.deepEqual([got.name, got.message], [error.name, error.message]);
  }
  const [format, transport, unsupported] = errors.map((error) => fromWire(toWire(error)));
  assert.ok(
    format instanceof FormatError && format.reason === "bad_picture" && format.where === "keyframe/T0/Q0/1.m4s",
  );
  assert.ok(transport instanceof TransportError && unsupported instanceof UnsupportedError);
  assert.equal(fromWire(toWire("words")).message, "words");
});

test("every buffer of a message is handed over once", () => {
  const shared = new Uint8Array(8);
  const message = { a: shared, b: [{ c: shared.subarray(2), d: null }, new Float32Array(1)], e: "text" };
  assert.equal(buffersOf(message).size, 2);
});

test("the digest in the headers is that of the answer, unless it travelled compressed", async () => {
  const bytes = new TextEncoder().encode("{}");
  const right = "sha-512=:AAAA:, sha-256=:RBNvo1WzZ4oRRq0W9+hknpT7T8If536DEMBg9hyq/4o=:";
  await checkReprDigest("airgs.json", bytes, new Headers({ "Repr-Digest": right }));
  await checkReprDigest("airgs.json", bytes, new Headers());
  const wrong = { "Repr-Digest": right.replace("RBN", "AAA") };
  await checkReprDigest("airgs.json", bytes, new Headers({ ...wrong, "Content-Encoding": "gzip" }));
  await assert.rejects(checkReprDigest("airgs.json", bytes, new Headers(wrong)), { reason: "hash_mismatch" });
});

/** What a client gets of an answer of eight parts, of so many bytes each, with half of the time-out between them. */
async function fetchSlowly(partBytes: number): Promise<[string | undefined, number]> {
  let came = 0;
  const answer = (signal: AbortSignal) => {
    let parts = 0;
    const body = new ReadableStream<Uint8Array>({
      start: (control) => signal.addEventListener("abort", () => control.error(new Error("aborted"))),
      pull: (control) => {
        mock.timers.tick(500 * TIMEOUT_S);
        if (signal.aborted) return;
        if (parts++ < 8) control.enqueue(new Uint8Array(partBytes));
        else control.close();
      },
    });
    return new Response(body);
  };
  mock.timers.enable({ apis: ["setTimeout"] });
  const asking = mock.method(globalThis, "fetch", async (_: string, init: RequestInit) =>
    answer(init.signal as AbortSignal),
  );
  try {
    const error = await new FileClient("http://a.example/").get({
      path: "a.bin",
      limit: 1 << 20,
      attempts: 1,
      patient: true,
      changing: false,
      signal: new AbortController().signal,
      accept: async (bytes) => {
        came = bytes.length;
      },
      onAsk: () => undefined,
      onBytes: () => undefined,
    });
    return [error?.detail, came];
  } finally {
    asking.mock.restore();
    mock.timers.reset();
  }
}

test("an answer that trickles is broken off, and one that is slow is not", async () => {
  const [fault, came] = await fetchSlowly(1);
  assert.match(fault ?? "", /the server is silent/);
  assert.equal(came, 0);
  assert.deepEqual(await fetchSlowly(LEAST_BYTES), [undefined, 8 * LEAST_BYTES]);
});

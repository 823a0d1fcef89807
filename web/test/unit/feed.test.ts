// Sessions one after another: what goes on when a server is lost, and what is over with a session.
import assert from "node:assert/strict";
import { test } from "node:test";
import { TransportError } from "../../src/media/errors.ts";
import type { Source } from "../../src/play/downloader.ts";
import { Feed } from "../../src/play/feed.ts";
import { Offers } from "../../src/play/offers.ts";
import { Stores } from "../../src/play/stores.ts";
import { playoutOf, rulesOf } from "../support/link.ts";
import { NumberTables, type PackageNumbers } from "../support/offers.ts";
import { readVectors } from "./files.ts";

const { packages } = readVectors("sessions") as { packages: PackageNumbers[] };

/** A feed whose server is away. */
function made() {
  const offers = new Offers(new NumberTables(packages[0]));
  const settings = rulesOf();
  const playout = playoutOf(offers, settings);
  const away = () => Promise.reject(new TransportError("away"));
  const opened = { firstByteS: 0, endS: 0, bytes: 1, cached: false, whole: [], refused: new Map() };
  const media: Source = { opened, fetch: away, refreshRoot: away };
  const problems: [unknown, boolean][] = [];
  const told = new EventTarget();
  const feed = new Feed({
    ...{ media, offers, settings, playout, stores: new Stores(offers), onEvent: () => {} },
    policy: () => "robust-mpc",
    onProblem: (error, fatal) => {
      problems.push([error, fatal]);
      told.dispatchEvent(new Event("problem"));
    },
  });
  return { feed, problems, told };
}

test("a server that is lost again and again is tried again, and another session can follow", async () => {
  const { feed, problems, told } = made();
  const browser = new EventTarget();
  globalThis.addEventListener = browser.addEventListener.bind(browser) as typeof addEventListener;
  const ended = new Promise<void>((resolve) => {
    told.addEventListener("problem", () => {
      if (problems.length === 4) resolve();
      else queueMicrotask(() => queueMicrotask(() => queueMicrotask(() => browser.dispatchEvent(new Event("online")))));
    });
  });
  feed.run(0);
  await ended;
  const signal = await feed.next();
  assert.equal(problems.length, 4);
  feed.run(1, signal);
  assert.equal(feed.from, 1);
  feed.close();
});

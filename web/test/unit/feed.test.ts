// Sessions one after another: what goes on when a server is lost, and what is over with a session.
import assert from "node:assert/strict";
import { test } from "node:test";
import { TransportError } from "../../src/media/errors.ts";
import { Feed } from "../../src/play/feed.ts";
import { ByView } from "../../src/play/fetch-plan.ts";
import type { Source } from "../../src/play/http-downloader.ts";
import { Offers } from "../../src/play/offers.ts";
import { Repairs } from "../../src/play/repairs.ts";
import { Stores } from "../../src/play/stores.ts";
import { playoutOf, rulesOf } from "../support/link.ts";
import { NumberTables, type PackageNumbers } from "../support/offers.ts";
import { readVectors } from "./files.ts";

const { packages } = readVectors("sessions") as { packages: PackageNumbers[] };

/** A feed whose server is away, with a choice of tiles that finds nothing lacking. */
function made(lacking: () => []) {
  const offers = new Offers(new NumberTables(packages[0]));
  const settings = rulesOf();
  const playout = playoutOf(offers, settings);
  const planner = new ByView(offers, playout, { at: () => null });
  planner.lacking = lacking;
  const away = () => Promise.reject(new TransportError("away"));
  const opened = { firstByteS: 0, endS: 0, bytes: 1, cached: false, whole: [], refused: new Map(), retries: [] };
  const media: Source = { opened, fetch: away, refreshRoot: away };
  const problems: [unknown, boolean][] = [];
  const told = new EventTarget();
  const feed = new Feed({
    ...{ media, offers, settings, playout, planner, Repairs, stores: new Stores(offers), onEvent: () => {} },
    policy: () => "robust-mpc",
    onProblem: (error, fatal) => {
      problems.push([error, fatal]);
      told.dispatchEvent(new Event("problem"));
    },
  });
  return { feed, problems, told };
}

test("a server that is lost again and again is tried again, by one session and beside one repair", async () => {
  let looks = 0;
  const { feed, problems, told } = made(() => {
    looks++;
    return [];
  });
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
  assert.equal(looks, 1); // all of that happened before it was time to look again
  await feed.next();
  assert.equal(problems.length, 4);
});

test("repairs that fail are told of, and another session can follow", async () => {
  const wrong = new Error("made up");
  const { feed, problems } = made(() => {
    throw wrong;
  });
  feed.run(0);
  await new Promise((resolve) => setTimeout(resolve));
  assert.ok(problems.some(([error, fatal]) => error === wrong && !fatal));
  feed.run(1, await feed.next());
  assert.equal(feed.from, 1);
  feed.close();
});

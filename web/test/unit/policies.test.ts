// The policies choose as the vectors say.
import assert from "node:assert/strict";
import { test } from "node:test";
import { HORIZON_SEGMENTS } from "../../src/generated/constants.ts";
import { Offers, optionsOf } from "../../src/play/offers.ts";
import { discountedThroughput } from "../../src/play/policies/mpc.ts";
import { estimateThroughput, type PlayerState } from "../../src/play/policies/state.ts";
import { NumberTables, type PackageNumbers } from "../support/offers.ts";
import { ADAPTIVE, makePolicy } from "../support/policies.ts";
import { readVectors } from "./files.ts";

interface State {
  package: number;
  position: number;
  end: number;
  decoded: number[];
  unavailable: number[];
  now_s: number;
  deadline_s: number;
  buffer_limit_s: number;
  request_latency_s: number;
  shown_quality: number | null;
  history: [number, number][];
  estimates: { throughput: number; discounted: number };
  choices: Record<string, [number, boolean, number]>;
}

const { packages, states } = readVectors("policies") as { packages: PackageNumbers[]; states: State[] };
const all = packages.map((numbers) => new Offers(new NumberTables(numbers), numbers.header_bytes));

function playerState(state: State, speed = 1): PlayerState {
  const offers = all[state.package];
  const { tiers, qualities } = offers.tables.root;
  const ahead = offers.upcoming(state.position, Math.min(state.position + HORIZON_SEGMENTS, state.end));
  const { group } = ahead[0].offer;
  const decoded = new Set(
    state.decoded.flatMap((count, q) =>
      Array.from({ length: count }, (_, tier) => (group * qualities.length + q) * tiers + tier),
    ),
  );
  const options = optionsOf(ahead[0].offer, decoded);
  return {
    ahead,
    decoded,
    options: options.filter((option) => !state.unavailable.includes(option.index)),
    nowS: state.now_s,
    deadlineS: state.deadline_s,
    bufferLimitS: state.buffer_limit_s,
    requestLatencyS: state.request_latency_s,
    shownQuality: state.shown_quality,
    history: state.history.map(([bytes, seconds]) => ({ bytes, seconds })),
    speed,
  };
}

const near = (got: number, expected: number) => Math.abs(got - expected) <= 1e-8 * Math.abs(expected);

test("estimates of the throughput", () => {
  for (const state of states) {
    const { history } = playerState(state);
    assert.ok(near(estimateThroughput(history), state.estimates.throughput));
    assert.ok(near(discountedThroughput(history), state.estimates.discounted));
  }
});

for (const [name, policy] of ADAPTIVE) {
  test(`every choice of ${name}`, () => {
    assert.ok(states.length > 60);
    for (const state of states) {
      const { index, fits, sizeBytes } = policy.choose(playerState(state));
      assert.deepEqual([index, fits, sizeBytes], state.choices[name], JSON.stringify(state));
    }
  });
}

test("at twice the speed a rung must come in half the time", () => {
  const sizes = (speed: number) => {
    const asked = states.map((state) => playerState({ ...state, deadline_s: state.now_s, unavailable: [] }, speed));
    return asked.map((state) => [...ADAPTIVE.values()].map((policy) => policy.choose(state).sizeBytes));
  };
  const total = (rows: number[][]) => rows.map((row) => row.reduce((a, b) => a + b, 0)).reduce((a, b) => a + b, 0);
  assert.ok(total(sizes(2)) < total(sizes(1)));
});

test("fixed rungs by level and by name", () => {
  const offers = all[0];
  const state = playerState({ ...states.find((state) => state.package === 0)!, unavailable: [] });
  for (const [name, rung] of [
    ["fixed:2", "Q0+L2"],
    ["fixed:Q1+L1", "Q1+L1"],
  ]) {
    assert.equal(offers.names[makePolicy(name, offers).choose(state).index], rung);
  }
  const smallest = Math.min(...state.options.slice(1).map((option) => option.sizeBytes));
  const without = { ...state, options: state.options.slice(1) };
  assert.equal(makePolicy("fixed:0", offers).choose(without).sizeBytes, smallest);
});

test("unknown policies", () => {
  for (const name of ["", "paper:1", "fixed", "fixed:", "fixed:3", "fixed:-1", "fixed:1.5", "best", "fixed:Q2+L0"]) {
    assert.throws(() => makePolicy(name, all[0]), /expected paper/, name);
  }
});

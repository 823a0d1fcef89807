// The table of policies by name.
import { HORIZON_SEGMENTS, type POLICY_NAMES } from "../../generated/constants.ts";
import type { Catalogue } from "../catalogue.ts";
import { ConfigError } from "../settings.ts";
import { chooseBola } from "./bola.ts";
import { chooseFixed } from "./fixed.ts";
import { chooseRobustMpc } from "./mpc.ts";
import { choosePaper, choosePaperLiteral, choosePaperNoCliff } from "./paper.ts";
import type { Policy } from "./state.ts";
import { chooseThroughput } from "./throughput.ts";

type Name = (typeof POLICY_NAMES)[number];

const CHOOSE: Record<Name, Policy["choose"]> = {
  paper: choosePaper,
  "paper-no-cliff": choosePaperNoCliff,
  "paper-literal": (state) => choosePaperLiteral(state),
  "paper-literal-no-cliff": (state) => choosePaperLiteral(state, Infinity),
  throughput: chooseThroughput,
  bola: chooseBola,
  "robust-mpc": chooseRobustMpc,
};

export const ADAPTIVE: ReadonlyMap<string, Policy> = new Map(
  Object.entries(CHOOSE).map(([name, choose]) => {
    const horizon = choose === chooseRobustMpc ? HORIZON_SEGMENTS : 1;
    return [name, { name, choose, mayAbandon: true, mayReplace: true, needsQuality: true, horizon }];
  }),
);

/** Name of the policy that plays what is wished for; "auto" is the best rung where no quality was measured to weigh. */
export function wishedPolicy(wishes: { quality: string; policy: string }, { measured }: Catalogue): string {
  if (wishes.quality !== "auto") return `fixed:${wishes.quality}`;
  return measured ? wishes.policy : "fixed:0";
}

/** A policy by name, or fixed:J (level J with the finest keys) or fixed:RUNG (such as Q1+L3).
 *
 * Throws ConfigError for other names.
 */
export function makePolicy(name: string, catalogue: Catalogue): Policy {
  const known = ADAPTIVE.get(name);
  if (known) return known;
  const rung = fixedRung(name, catalogue);
  const choose: Policy["choose"] = (state) => chooseFixed(state, rung);
  return { name, choose, mayAbandon: false, mayReplace: false, needsQuality: false, horizon: 1 };
}

function fixedRung(name: string, { names, tables }: Catalogue): number {
  const levels = tables.root.levels.length;
  const wanted = name.startsWith("fixed:") ? name.slice("fixed:".length) : "";
  if (names.includes(wanted)) return names.indexOf(wanted);
  if (/^[0-9]+$/.test(wanted) && Number(wanted) < levels) return Number(wanted);
  const expected = `${[...ADAPTIVE.keys()].join(", ")}, fixed:0 … fixed:${levels - 1} or fixed:${names.at(-1)}`;
  throw new ConfigError(`policy: expected ${expected}, got ${name}`);
}

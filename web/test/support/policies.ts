// All policies by name, which a player loads only as it needs them.
import type { Offers } from "../../src/play/offers.ts";
import { fixedPolicy, ROBUST_MPC } from "../../src/play/policies/mpc.ts";
import { OTHERS } from "../../src/play/policies/named.ts";
import type { Policy } from "../../src/play/policies/state.ts";

export const ADAPTIVE: ReadonlyMap<string, Policy> = new Map([...OTHERS, [ROBUST_MPC.name, ROBUST_MPC]]);

/** A policy by name, or one that plays a rung for ever: `fixedPolicy`, and what that throws. */
export const makePolicy = (name: string, offers: Offers): Policy => ADAPTIVE.get(name) ?? fixedPolicy(name, offers);

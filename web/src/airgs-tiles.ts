// What the player loads for a package in several tiles, which it fetches by view.
export { ByView } from "./play/fetch-plan.ts";
export { Repairs } from "./play/repairs.ts";

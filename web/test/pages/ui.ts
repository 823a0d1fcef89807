// The element with a player that pretends, in a situation of the query: `?case=NAME`. The page drives itself with real
// input through `drive`, which test/open.mjs puts into it, and reports what came of it.
import { cases } from "../support/ui-cases.ts";

declare global {
  interface Window {
    report: Promise<object>;
  }
}

const name = new URLSearchParams(location.search).get("case") ?? "";
window.report = cases[name]();

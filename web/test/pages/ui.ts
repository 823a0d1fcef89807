// The element with a player that pretends, in situations of the query one after another: `?cases=NAME,NAME`. The page
// drives itself with real input through `drive`, which test/open.mjs puts into it, and reports what came of each.
import { cases, clear } from "../support/ui-cases.ts";

declare global {
  interface Window {
    report: Promise<object>;
  }
}

async function run(names: string[]): Promise<object> {
  const report: Record<string, unknown> = {};
  for (const name of names) {
    report[name] = await cases[name]().catch((error: Error) => ({ error: String(error) }));
    clear();
  }
  return report;
}

window.report = run((new URLSearchParams(location.search).get("cases") ?? "").split(","));

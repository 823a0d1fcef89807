// Sorts in a thread of its own, one request after the other; sorter.ts is its other end.
import { DepthSorter, type DepthView } from "./sort.ts";

/** Means of a key, kept until others come for it. `view`: sort them; null: forget them. */
export interface SortRequest {
  key: string;
  means: Float32Array | null;
  view: DepthView | null;
}

/** What comes of a request with a view: the rows, or null where no means were given for its key. */
export type SortAnswer = Uint32Array<ArrayBuffer> | null;

/** The global scope of a worker, which the types of pages do not have. */
interface Scope {
  onmessage: (event: MessageEvent<SortRequest>) => void;
  postMessage(answer: SortAnswer, transfer: Transferable[]): void;
}

/** What the thread does from now on. */
export function run(): void {
  const sorter = new DepthSorter();
  const known = new Map<string, Float32Array>();
  const scope = globalThis as unknown as Scope;
  scope.onmessage = ({ data: { key, means, view } }) => {
    if (means) known.set(key, means);
    if (!view) {
      known.delete(key);
      return;
    }
    const kept = known.get(key);
    const rows = kept ? sorter.order(kept, view) : null;
    scope.postMessage(rows, rows ? [rows.buffer] : []);
  };
}

// The page's end of the line to the worker.
import { aborted, fromWire, UnsupportedError } from "./errors.ts";
import type { Call, Calls, Note, Reply, Request } from "./messages.ts";

interface Waiting {
  resolve: (value: Calls[Call]["value"]) => void;
  reject: (error: Error) => void;
  onEvent: (event: Calls[Call]["event"]) => void;
}

/** What may go with a call. */
export interface CallOptions<K extends Call> {
  signal?: AbortSignal | undefined;
  onEvent?: (event: Calls[K]["event"], id: number) => void;
}

/** Asks a worker, and gives its answers. */
export class Caller {
  readonly #worker: Worker;
  readonly #waiting = new Map<number, Waiting>();
  #next = 0;
  #ended: Error | null = null;

  /** Throws UnsupportedError where no worker can be started. */
  constructor(start: () => Worker) {
    try {
      this.#worker = start();
    } catch (error) {
      throw noWorker(error);
    }
    this.#worker.onmessage = ({ data }: MessageEvent<Reply>) => this.#hear(data);
    this.#worker.onerror = (event) => this.end(noWorker(event.message || "its script was not loaded"));
    this.#worker.onmessageerror = () => this.end(noWorker("a message of it could not be read"));
  }

  /** Calls. An aborted signal makes the worker give up, whose answer says so. */
  call<K extends Call>(call: K, args: Calls[K]["args"], options: CallOptions<K> = {}): Promise<Calls[K]["value"]> {
    const id = this.#next++;
    if (this.#ended) return Promise.reject(this.#ended);
    const { signal, onEvent } = options;
    const answer = new Promise<Calls[K]["value"]>((resolve, reject) => {
      const hear = (event: Calls[Call]["event"]) => onEvent?.(event as Calls[K]["event"], id);
      this.#waiting.set(id, { resolve: resolve as Waiting["resolve"], reject, onEvent: hear });
    });
    const request: Request<K> = { id, call, args };
    this.#worker.postMessage(request);
    const cancel = () => this.tell({ cancel: id });
    signal?.addEventListener("abort", cancel, { once: true });
    if (signal?.aborted) cancel();
    return answer;
  }

  tell(note: Note): void {
    if (!this.#ended) this.#worker.postMessage(note);
  }

  /** Ends the worker; what is still asked for is rejected. */
  end(error: Error = aborted("closed")): void {
    this.#ended ??= error;
    this.#worker.terminate();
    for (const { reject } of this.#waiting.values()) reject(this.#ended);
    this.#waiting.clear();
  }

  #hear(reply: Reply): void {
    const waiting = this.#waiting.get(reply.id);
    if (!waiting) return;
    if ("event" in reply) {
      waiting.onEvent(reply.event);
      return;
    }
    this.#waiting.delete(reply.id);
    if ("error" in reply) waiting.reject(fromWire(reply.error));
    else waiting.resolve(reply.value);
  }
}

function noWorker(why: unknown): UnsupportedError {
  const words = why instanceof Error ? why.message : String(why);
  return new UnsupportedError(`the worker that decodes failed: ${words} (a page's policy must allow worker-src blob:)`);
}

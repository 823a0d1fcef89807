// The worker: calls of the page in, answers and events out.
import { Engine } from "./engine.ts";
import { toWire } from "./errors.ts";
import { buffersOf, type Calls, type Note, type Reply, type Request } from "./messages.ts";

let engine: Engine | null = null;
const underWay = new Map<number, AbortController>();

function say(reply: Reply): void {
  postMessage(reply, { transfer: [...buffersOf(reply)] });
}

async function answer({ id, call, args }: Request, signal: AbortSignal): Promise<Calls[typeof call]["value"]> {
  const context = { id, signal, emit: (event: Calls[typeof call]["event"]) => say({ id, event }) };
  if (call === "open") {
    const found = await Engine.open(args as Calls["open"]["args"], context, (passing) => say({ passing }));
    engine = found.engine;
    return found.opened;
  }
  if (!engine) throw new Error("expected open() before anything else");
  return engine[call](args as never, context as never);
}

async function respond(request: Request): Promise<void> {
  const { id } = request;
  const stop = new AbortController();
  underWay.set(id, stop);
  const reply: Reply = await answer(request, stop.signal).then(
    (value) => ({ id, value }),
    (error) => ({ id, error: toWire(error) }),
  );
  underWay.delete(id);
  say(reply);
}

export function run(): void {
  globalThis.onmessage = ({ data }: MessageEvent<Request | Note>) => {
    if ("call" in data) return respond(data);
    const { cancel, taken } = data;
    if (cancel !== undefined) {
      underWay.get(cancel)?.abort();
      engine?.ahead.drop(cancel);
    }
    if (taken) engine?.ahead.taken(taken.id, taken.t);
  };
}

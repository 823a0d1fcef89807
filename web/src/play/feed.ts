// What brings files: one session after another over the same playout and stores, each until its end, or until another
// one is wanted.
import { POLICY_NAMES } from "../generated/constants.ts";
import { untilOnline } from "../media/bell.ts";
import { TransportError } from "../media/errors.ts";
import type { SessionEvent } from "./downloader.ts";
import { HttpDownloader, type Source } from "./downloader.ts";
import type { Offers } from "./offers.ts";
import { fixedPolicy, ROBUST_MPC } from "./policies/mpc.ts";
import type { Policy } from "./policies/state.ts";
import { Session, type Shared } from "./session.ts";

/** Seconds after which a session that lost its server begins again, unless the browser says before that it is back. */
const RETRY_S = 5;

export interface FeedParts extends Shared {
  media: Source;
  policy: () => string;
  onEvent: (event: SessionEvent) => void;
  /** Something went wrong; `fatal`: nothing more will come. */
  onProblem: (error: unknown, fatal: boolean) => void;
}

export class Feed {
  readonly #parts: FeedParts;
  readonly #downloader: HttpDownloader;
  #stop = new AbortController();
  #running: Promise<void> = Promise.resolve();
  from = 0;

  constructor(parts: FeedParts) {
    this.#parts = parts;
    this.#downloader = new HttpDownloader(parts.media);
  }

  /** Ends the session that is under way; the signal of the next one, aborted if that is not wanted any more either. */
  async next(): Promise<AbortSignal> {
    this.#stop.abort();
    this.#stop = new AbortController();
    const { signal } = this.#stop;
    await this.#running;
    return signal;
  }

  /** Fetch from a position on; `signal` is that of `next`, or the first one. */
  run(from: number, signal: AbortSignal = this.#stop.signal): void {
    this.#running = this.#fetch(from, signal);
  }

  close(): void {
    this.#stop.abort();
  }

  async #fetch(from: number, signal: AbortSignal): Promise<void> {
    this.from = from;
    while (!(await this.#session(signal))) {
      await untilOnline(1e3 * RETRY_S, signal);
      if (signal.aborted) return;
      this.from = (this.#parts.playout.last?.position ?? this.from - 1) + 1;
    }
  }

  /** Fetch from where a session is to begin; false: its server was lost. */
  async #session(signal: AbortSignal): Promise<boolean> {
    const { onEvent, onProblem, ...parts } = this.#parts;
    try {
      const policy = await policyOf(parts.policy(), parts.offers);
      const session = new Session({ ...parts, downloader: this.#downloader, policy }, signal, this.from);
      for await (const event of session.run()) onEvent(event);
    } catch (error) {
      if (signal.aborted) return true;
      const away = error instanceof TransportError;
      onProblem(error, !away);
      return !away;
    }
    return true;
  }
}

async function policyOf(name: string, offers: Offers): Promise<Policy> {
  if (name === ROBUST_MPC.name) return ROBUST_MPC;
  if (!(POLICY_NAMES as readonly string[]).includes(name)) return fixedPolicy(name, offers);
  const { POLICIES } = await import("../airgs-more.ts"); // all but the default one are beside this script
  return POLICIES.get(name)!;
}

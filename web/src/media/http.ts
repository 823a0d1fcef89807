// Single files over HTTP: asked for again, later and later, until what comes is right or it is no use.
//
// A server that cannot be reached, or says that it is busy, is waited for. Any other fault is the file's: after some of
// them the file cannot be had, as one with status 404 at once.
import { concat } from "../format/concat.ts";
import { FormatError, type Reason } from "../format/errors.ts";
import { BACKOFF_S, BUSY, GARBLED, HEADER_BYTES, LONGEST_PAUSE_S, TIMEOUT_S } from "../generated/constants.ts";
import { untilOnline } from "./bell.ts";
import { TransportError } from "./errors.ts";

const TO_ASK_AGAIN: readonly Reason[] = GARBLED;

/** An answer that was not taken. */
export interface Retry {
  path: string;
  why: string;
  bytes: number;
}

/** What is asked for, and who is told what comes. */
export interface Ask {
  path: string;
  /** The most bytes that the file may have; of a longer one, a byte more is read. */
  limit: number;
  /** Faulty answers after which the file cannot be had. */
  attempts: number;
  /** Wait for a server that is away; else it is a TransportError. */
  patient: boolean;
  /** A cached answer is to be checked with the server. */
  changing: boolean;
  signal: AbortSignal;
  /** Takes the file in. Throws FormatError for one that is not what it should be. */
  accept(bytes: Uint8Array, headers: Headers): Promise<void>;
  /** A request goes out. */
  onAsk(url: string): void;
  /** So many bytes have come, headers included. */
  onBytes(bytes: number): void;
  onRetry(retry: Retry): void;
}

/** An answer that did not come whole: another may. */
class PassingError extends FormatError {
  constructor(
    path: string,
    words: string,
    /** Why it is the server's fault: it is busy, or perhaps cannot be reached. */
    readonly away: "busy" | "unreachable" | null = null,
  ) {
    super("missing_file", path, words);
  }
}

/** Fetches files of a package. */
export class FileClient {
  /** When the server last gave an answer that was its own. */
  #answeredMs = Number.NEGATIVE_INFINITY;

  /** `base` is the address of the folder, with a slash at the end. */
  constructor(readonly base: string) {}

  /** Fetches a file. Resolves to why it cannot be had; null: it was taken in, or given up.
   *
   * Throws TransportError where the server is away and nobody wants to wait.
   */
  async get(ask: Ask): Promise<FormatError | null> {
    const { path, attempts, patient, signal } = ask;
    for (let tries = 0, faults = 0; ; tries++) {
      const answer = new Answer(ask);
      const askedMs = performance.now();
      const error = await this.#fault(answer, tries > 0);
      if (!error || signal.aborted) return null;
      const away = this.#isAway(error, askedMs);
      if (away && !patient) throw new TransportError(`${this.base}${path}: ${error.detail}`);
      if (!away) faults++;
      const passing = error instanceof PassingError || TO_ASK_AGAIN.includes(error.reason);
      if (faults === attempts || !passing) return plain(error);
      ask.onRetry({ path, why: error.detail, bytes: answer.bytes });
      await rest(tries, signal);
    }
  }

  /** Whether to wait for the server. One that has answered others since is not away: the fault is the file's. */
  #isAway(error: FormatError, askedMs: number): boolean {
    if (!(error instanceof PassingError)) return false;
    return error.away === "busy" || (error.away === "unreachable" && this.#answeredMs < askedMs);
  }

  async #fault(answer: Answer, again: boolean): Promise<FormatError | null> {
    try {
      const url = new URL(answer.ask.path, this.base).href;
      const { bytes, headers } = await answer.receive(url, again, () => {
        this.#answeredMs = performance.now();
      });
      await answer.ask.accept(bytes, headers);
      return null;
    } catch (error) {
      if (error instanceof FormatError) return error;
      if (answer.ask.signal.aborted) return null;
      throw error;
    }
  }
}

/** What comes of one request. */
class Answer {
  bytes = 0;
  readonly #stop = new AbortController();
  #silence: ReturnType<typeof setTimeout> | undefined;

  constructor(readonly ask: Ask) {}

  /** The whole answer. Throws PassingError, FormatError(missing_file). */
  async receive(url: string, again: boolean, onAnswer: () => void): Promise<{ bytes: Uint8Array; headers: Headers }> {
    const { signal } = this.ask;
    const stop = () => this.#stop.abort();
    signal.addEventListener("abort", stop);
    if (signal.aborted) stop();
    try {
      const response = await this.#head(url, again);
      if (!BUSY.includes(response.status)) onAnswer();
      this.#count(HEADER_BYTES); // pages are not told how many there were
      if (response.status !== 200) throw refusal(this.ask.path, response.status);
      return { bytes: await this.#body(response), headers: response.headers };
    } finally {
      clearTimeout(this.#silence);
      signal.removeEventListener("abort", stop);
      this.#stop.abort(); // of an answer that is not wanted, nothing more is read
    }
  }

  async #head(url: string, again: boolean): Promise<Response> {
    const { path, changing, onAsk } = this.ask;
    onAsk(url);
    this.#listen();
    try {
      const cache = again ? "reload" : changing ? "no-cache" : "default"; // a cached answer may be what was wrong
      return await fetch(url, { cache, signal: this.#stop.signal });
    } catch (error) {
      throw new PassingError(path, `the server cannot be reached: ${reason(error)}`, "unreachable");
    }
  }

  async #body(response: Response): Promise<Uint8Array> {
    const { path, limit } = this.ask;
    const parts: Uint8Array[] = [];
    let size = 0;
    const reader = response.body?.getReader();
    while (reader && size <= limit) {
      const { done, value } = await reader.read().catch((error: unknown) => {
        throw new PassingError(path, `broken off: ${reason(error)}`);
      });
      if (done) break;
      this.#listen();
      this.#count(value.length);
      parts.push(value);
      size += value.length;
    }
    return parts.length === 1 ? parts[0] : concat(parts, Uint8Array);
  }

  #listen(): void {
    clearTimeout(this.#silence);
    this.#silence = setTimeout(() => this.#stop.abort(), 1e3 * TIMEOUT_S);
  }

  #count(bytes: number): void {
    this.bytes += bytes;
    this.ask.onBytes(bytes);
  }
}

/** A quarter of a second, longer each time, and not the same for everybody who lost the same server. */
async function rest(tries: number, signal: AbortSignal): Promise<void> {
  const longest = 1e3 * Math.min(LONGEST_PAUSE_S, BACKOFF_S * 2 ** tries);
  await untilOnline(longest * (0.5 + 0.5 * Math.random()), signal);
}

function refusal(path: string, status: number): FormatError {
  const words = `expected a file, got status ${status}`;
  if (BUSY.includes(status)) return new PassingError(path, words, "busy");
  return status >= 500 ? new PassingError(path, words) : new FormatError("missing_file", path, words);
}

const plain = ({ reason, where, detail }: FormatError) => new FormatError(reason, where, detail);

const reason = (error: unknown) => (error instanceof Error ? error.message : String(error));

const SHA256 = /\bsha-256=:([A-Za-z0-9+/]+=*):/;

/** Throws FormatError(hash_mismatch) for bytes that are not those of the header Repr-Digest (RFC 9530), the only check
 * of airgs.json, which no table leads to.
 *
 * One of an answer that travelled compressed is of the compressed bytes, which a page does not see: it says nothing, as
 * one without SHA-256.
 */
export async function checkReprDigest(where: string, bytes: Uint8Array, headers: Headers): Promise<void> {
  const expected = headers.has("Content-Encoding") ? null : SHA256.exec(headers.get("Repr-Digest") ?? "");
  if (!expected) return;
  const hash = await crypto.subtle.digest("SHA-256", bytes as Uint8Array<ArrayBuffer>);
  if (btoa(String.fromCharCode(...new Uint8Array(hash))) !== expected[1]) {
    throw new FormatError("hash_mismatch", where, "the SHA-256 differs from the one in the headers of the answer");
  }
}

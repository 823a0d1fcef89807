// Single files over HTTP: asked for again, later and later, until what comes is right or it is no use.
//
// A server that cannot be reached, or says that it is busy, is waited for, and people are told. Any other fault is the
// file's: after some of them the file cannot be had, as one with status 404 at once. Redirects are followed: what other
// origins answer is read only where their CORS headers allow it, without cookies, and is checked like all else.
import { concat } from "../format/collections.ts";
import { FormatError, type Reason } from "../format/errors.ts";
import {
  BACKOFF_S,
  BUSY,
  GARBLED,
  HEADER_BYTES,
  LEAST_BYTES,
  LONGEST_PAUSE_S,
  TIMEOUT_S,
} from "../generated/constants.ts";
import { following, untilOnline } from "./bell.ts";
import { TransportError } from "./errors.ts";

const MOST_AFTER_S = 3600; // a server that wants more is asked before

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
  onAsk(url: string): void;
  /** So many bytes have come, headers included. */
  onBytes(bytes: number): void;
}

/** An answer that did not come whole: another may. */
class PassingError extends FormatError {
  constructor(
    path: string,
    words: string,
    /** Why it is the server's fault: it is busy, or perhaps cannot be reached. */
    readonly away: "busy" | "unreachable" | null = null,
    /** When it wants to be asked again, seconds. */
    readonly afterS = 0,
  ) {
    super("missing_file", path, words);
  }
}

export class FileClient {
  #answeredMs = Number.NEGATIVE_INFINITY;

  /** `base` is the address of the folder, with a slash at the end of its path; its query goes with every file. */
  constructor(
    readonly base: string,
    private readonly onPassing: (words: string) => void = () => {},
  ) {}

  /** Resolves to why a file cannot be had; null: taken in or given up. Throws TransportError unless patient. */
  async get(ask: Ask): Promise<FormatError | null> {
    const { path, attempts, patient, signal } = ask;
    for (let tries = 0, faults = 0; ; tries++) {
      const askedMs = performance.now();
      const error = await this.#fault(ask, tries > 0);
      if (!error || signal.aborted) return null;
      const passing = error instanceof PassingError ? error : null;
      // A server that has answered others since is not away: the fault is the file's.
      const away = passing?.away === "busy" || (passing?.away === "unreachable" && this.#answeredMs < askedMs);
      if (away && !patient) throw new TransportError(`${this.base.split("?")[0]}${path}: ${error.detail}`);
      if (!away) faults++;
      if (faults === attempts || !(passing || (GARBLED as readonly Reason[]).includes(error.reason)))
        return new FormatError(error.reason, error.where, error.detail);
      if (passing) this.onPassing(`${path}: ${error.detail}, trying again`);
      const longestS = Math.min(LONGEST_PAUSE_S, BACKOFF_S * 2 ** tries);
      const pauseS = Math.max(passing?.afterS ?? 0, longestS * (0.5 + 0.5 * Math.random())); // not the same for all
      await untilOnline(1e3 * pauseS, signal);
    }
  }

  async #fault(ask: Ask, again: boolean): Promise<FormatError | null> {
    try {
      const url = new URL(ask.path, this.base);
      url.search = new URL(this.base).search;
      const { bytes, headers } = await receive(url, ask, again, () => {
        this.#answeredMs = performance.now();
      });
      await ask.accept(bytes, headers).catch((error) => {
        if (error instanceof FormatError && /^\s*</.test(new TextDecoder().decode(bytes.subarray(0, 64))))
          throw new FormatError(error.reason, error.where, "expected a file, got a web page");
        throw error;
      });
      return null;
    } catch (error) {
      if (error instanceof FormatError) return error;
      if (ask.signal.aborted) return null;
      throw error;
    }
  }
}

/** Asks once for a file; `again`: for no cached one. Throws PassingError, FormatError(missing_file). */
async function receive(
  url: URL,
  { path, limit, changing, signal, onAsk, onBytes }: Ask,
  again: boolean,
  onAnswer: () => void,
): Promise<{ bytes: Uint8Array; headers: Headers }> {
  const ending = following(signal);
  let patience: ReturnType<typeof setTimeout> | undefined;
  let silent = false;
  let came = 0; // of the next LEAST_BYTES
  const wait = () => {
    clearTimeout(patience);
    patience = setTimeout(() => {
      silent = true;
      ending.abort();
    }, 1e3 * TIMEOUT_S);
    came = 0;
  };
  const why = (words: string, error: unknown) =>
    silent ? `the server is silent: fewer than ${LEAST_BYTES} bytes in ${TIMEOUT_S} s` : `${words}: ${reason(error)}`;
  try {
    onAsk(url.href);
    wait();
    const cache = again ? "reload" : changing ? "no-cache" : "default";
    const response = await fetch(url, { cache, signal: ending.signal }).catch(async (error: unknown) => {
      const { origin } = globalThis;
      const foreign = url.origin !== origin && !ending.signal.aborted;
      const there = foreign && (await fetch(url, { mode: "no-cors", signal: ending.signal }).catch(() => null));
      if (there) throw new PassingError(path, `the server lets no page of ${origin} read it (CORS)`);
      throw new PassingError(path, why("the server cannot be reached", error), "unreachable");
    });
    wait();
    if (!BUSY.includes(response.status)) onAnswer();
    onBytes(HEADER_BYTES); // pages are not told how many there were
    if (response.status !== 200) throw refusal(path, response);
    const parts: Uint8Array[] = [];
    const reader = response.body?.getReader();
    for (let size = 0; reader && size <= limit; ) {
      const { done, value } = await reader.read().catch((error: unknown) => {
        throw new PassingError(path, why("broken off", error));
      });
      if (done) break;
      came += value.length;
      if (came >= LEAST_BYTES) wait();
      onBytes(value.length);
      parts.push(value);
      size += value.length;
    }
    return { bytes: parts.length === 1 ? parts[0] : concat(Uint8Array, parts), headers: response.headers };
  } finally {
    clearTimeout(patience);
    ending.abort(); // of an answer that is not wanted, nothing more is read
  }
}

function refusal(path: string, { status, headers }: Response): FormatError {
  const words = `expected a file, got status ${status}`;
  if (BUSY.includes(status))
    return new PassingError(path, words, "busy", Math.min(Number(headers.get("Retry-After")) || 0, MOST_AFTER_S));
  return status >= 500 ? new PassingError(path, words) : new FormatError("missing_file", path, words);
}

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

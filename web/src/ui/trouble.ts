// What went wrong, in words for people: what it means and what they can do.
import type { FormatError, Reason } from "../format/errors.ts";
import { icon, make, OTHERS, write } from "./dom.ts";

export interface Trouble {
  readonly icon: string;
  readonly title: string;
  readonly text: string;
  readonly details: string;
  readonly again: boolean;
}

const DAMAGED = "is not what the package says it is. It may be damaged, or still being copied.";
const BROKEN = "breaks the format. Whoever made the package has to make it again.";
const INEXACT =
  "What it decodes is not what was sent, so that the scene would fall apart. Chrome and Edge decode exactly.";
const UNREACHED =
  "Look at the address and the connection. From another site, its server has to allow this page (CORS).";
/** What servers do, as http.ts says it: a title, and what that means. */
const SERVERS: readonly (readonly [RegExp, string, string])[] = [
  [/ status 401/, "The package needs a sign-in", "Its server asks who you are (status 401)."],
  [
    / status 403/,
    "The package may not be read",
    "Its server refuses (status 403). A key in the address, after the ?, may be missing or too old.",
  ],
  [/ status (429|50\d)/, "The server is busy", "Try again in a while."],
  [/ status (?!404|410)/, "The server does not give it", "Look at the address."],
  [/ a web page/, "A web page is there", "The server sends one in place of the package. Look at the address."],
  [/ \(CORS\)/, "The package is not for this page", "Whoever runs its server has to allow that."],
  [/ server is silent/, "The server does not answer", "It takes requests, and then nothing comes."],
];
const UNPLAYED = "This browser cannot play it";
const UNDRAWN = [
  OTHERS.browser,
  "This browser cannot draw it",
  "It lacks WebGL 2, or hardware acceleration is switched off in its settings.",
] as const;
const REASONS: Readonly<Partial<Record<Reason, string>>> = {
  not_json: "is not a table. The address may lead to something else than a package.",
  too_large: "is larger than any player may accept.",
  unknown_version: "is of another version of the format than this player knows.",
  missing_file: "is missing.",
  size_mismatch: DAMAGED,
  hash_mismatch: DAMAGED,
  bad_picture: "holds pictures that cannot be decoded.",
};

const telling =
  (details: string) =>
  (icon: string, title: string, text: string, again = false): Trouble => ({ icon, title, text, details, again });

/** Says what this browser lacks to play anything; null: nothing. */
export function lacking(): Trouble | null {
  const told = telling(navigator.userAgent);
  if (!window.isSecureContext) {
    const text = "Browsers decode video for a page only over HTTPS or on localhost. Open it with https:// in front.";
    return told(OTHERS.lock, "This page needs HTTPS", text);
  }
  if (typeof VideoDecoder === "undefined") {
    const text = /Android/.test(navigator.userAgent)
      ? "It lacks WebCodecs, as Firefox on Android does. Chrome on the same phone has it."
      : "It lacks WebCodecs. Current versions of Chrome, Edge, Firefox and Safari have it.";
    return told(OTHERS.browser, UNPLAYED, text);
  }
  return typeof WebGL2RenderingContext === "undefined" ? told(...UNDRAWN) : null;
}

export function troubleOf(error: unknown, src: string): Trouble {
  const name = error instanceof Error ? error.name : "Error";
  const message = error instanceof Error ? error.message : String(error);
  const told = telling(`${name}: ${message}\n${src}\n${navigator.userAgent}`);
  const [, title, means] = SERVERS.find(([pattern]) => pattern.test(message)) ?? [];
  if (title) return told(OTHERS.offline, title, `${message.replace(/ \(\w+_\w+\)$/, "")}. ${means}`, true);
  if (name === "FormatError") {
    const { reason, where } = error as FormatError;
    const nothing = where.endsWith("airgs.json") && reason === "missing_file";
    const known = nothing ? "No package is there" : "This package cannot be played";
    const title = reason === "unknown_version" ? "Made for another player" : known;
    const text = `${where} ${REASONS[reason] ?? BROKEN}${nothing ? " Look at the address." : ""}`;
    return told(OTHERS.file, title, text, reason === "missing_file" || REASONS[reason] === DAMAGED);
  }
  if (name === "UnsupportedError") {
    if (/\bluma\b/.test(message)) return told(OTHERS.browser, "This browser changes the pictures", INEXACT);
    return told(OTHERS.browser, UNPLAYED, `${message[0].toUpperCase()}${message.slice(1)}.`);
  }
  if (name === "TransportError" || error instanceof TypeError) {
    const title = navigator.onLine ? "The package cannot be reached" : "There is no network";
    return told(OTHERS.offline, title, `${message}. ${UNREACHED}`, true);
  }
  if (name === "ConfigError") return told(OTHERS.warn, "It cannot be played with these settings", message);
  if (/\bWebGL2\b/.test(message)) return told(...UNDRAWN, true);
  return told(OTHERS.warn, "Something went wrong", message, true);
}

const COPIED_MS = 2000;

/** A card with a trouble; `again` is called when people want to try again. */
export function card(trouble: Trouble, again: () => void, signal: AbortSignal): HTMLElement {
  const copy = make("button", { type: "button" }, "Copy details");
  const buttons = make("div", { class: "buttons" }, copy);
  copy.addEventListener("click", () => copyText(copy, trouble.details), { signal });
  if (trouble.again) {
    const retry = make("button", { type: "button", class: "main" }, "Try again");
    retry.addEventListener("click", again, { signal });
    buttons.prepend(retry);
  }
  const words = [make("h2", {}, trouble.title), make("p", {}, trouble.text)];
  return make("div", { class: "card", part: "card", role: "alert" }, icon(trouble.icon), ...words, buttons);
}

async function copyText(button: HTMLButtonElement, text: string): Promise<void> {
  try {
    await navigator.clipboard.writeText(text);
    write(button, "Copied");
    window.setTimeout(() => write(button, "Copy details"), COPIED_MS);
  } catch {
    // Not allowed, or no clipboard: then people can select it.
    button.replaceWith(make("pre", { tabindex: 0 }, text));
  }
}

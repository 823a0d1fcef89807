// What went wrong, in words for people: what it means and what they can do.
import type { FormatError, Reason } from "../format/errors.ts";
import { icon, make, OTHERS, write } from "./dom.ts";

export interface Trouble {
  /** Its outlines. */
  readonly icon: string;
  readonly title: string;
  readonly text: string;
  /** For those who are asked for help. */
  readonly details: string;
  readonly again: boolean;
}

const DAMAGED = "is not what the package says it is. It may be damaged, or still being copied.";
const BROKEN = "breaks the format. Whoever made the package has to make it again.";
const INEXACT =
  "What it decodes is not what was sent, so that the scene would fall apart. Chrome and Edge decode exactly.";
const UNDRAWN = {
  icon: OTHERS.browser,
  title: "This browser cannot draw it",
  text: "It lacks WebGL 2, or hardware acceleration is switched off in its settings.",
} as const;
const REASONS: Readonly<Partial<Record<Reason, string>>> = {
  not_json: "is not a table. The address may lead to something else than a package.",
  too_large: "is larger than any player may accept.",
  unknown_version: "is of another version of the format than this player knows.",
  missing_file: "is missing.",
  size_mismatch: DAMAGED,
  hash_mismatch: DAMAGED,
  bad_picture: "holds pictures that cannot be decoded.",
};

/** Says what this browser lacks to play anything; null: nothing. */
export function lacking(): Trouble | null {
  const here = { details: navigator.userAgent, again: false };
  if (!window.isSecureContext) {
    return {
      ...here,
      icon: OTHERS.lock,
      title: "This page needs HTTPS",
      text: "Browsers decode video for a page only over HTTPS or on localhost. Open it with https:// in front.",
    };
  }
  if (typeof VideoDecoder === "undefined") {
    return {
      ...here,
      icon: OTHERS.browser,
      title: "This browser cannot play it",
      text: /Android/.test(navigator.userAgent)
        ? "It lacks WebCodecs, as Firefox on Android does. Chrome on the same phone has it."
        : "It lacks WebCodecs. Current versions of Chrome, Edge, Firefox and Safari have it.",
    };
  }
  if (typeof WebGL2RenderingContext === "undefined") {
    return { ...here, ...UNDRAWN };
  }
  return null;
}

export function troubleOf(error: unknown, src: string): Trouble {
  const name = error instanceof Error ? error.name : "Error";
  const message = error instanceof Error ? error.message : String(error);
  const details = `${name}: ${message}\n${src}\n${navigator.userAgent}`;
  if (name === "FormatError") {
    const { reason, where } = error as FormatError;
    const newer = reason === "unknown_version";
    const nothing = where.endsWith("airgs.json") && reason === "missing_file";
    return {
      icon: OTHERS.file,
      title: newer ? "Made for another player" : nothing ? "No package is there" : "This package cannot be played",
      text: `${where} ${REASONS[reason] ?? BROKEN}${nothing ? " Look at the address." : ""}`,
      details,
      again: reason === "missing_file" || REASONS[reason] === DAMAGED,
    };
  }
  if (name === "UnsupportedError") {
    const inexact = /\bluma\b/.test(message);
    return {
      icon: OTHERS.browser,
      title: inexact ? "This browser changes the pictures" : "This browser cannot play it",
      text: inexact ? INEXACT : `${message[0].toUpperCase()}${message.slice(1)}.`,
      details,
      again: false,
    };
  }
  if (name === "TransportError" || error instanceof TypeError) {
    return {
      icon: OTHERS.offline,
      title: navigator.onLine ? "The package cannot be reached" : "There is no network",
      text: "Look at the address and the connection. From another site, its server has to allow this page (CORS).",
      details,
      again: true,
    };
  }
  if (name === "ConfigError") {
    return {
      icon: OTHERS.warn,
      title: "It cannot be played with these settings",
      text: message,
      details,
      again: false,
    };
  }
  if (/\bWebGL2\b/.test(message)) return { ...UNDRAWN, details, again: true };
  return { icon: OTHERS.warn, title: "Something went wrong", text: message, details, again: true };
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
  return make(
    "div",
    { class: "card", part: "card", role: "alert" },
    icon(trouble.icon),
    make("h2", {}, trouble.title),
    make("p", {}, trouble.text),
    buttons,
  );
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

// What goes wrong between a server, a browser and a page, and how it crosses the border between worker and page.
import { FormatError, type Reason } from "../format/errors.ts";

/** A server that cannot be reached, or does not speak HTTP as it should. */
export class TransportError extends Error {
  override name = "TransportError";
}

/** A browser that cannot play packages, and why. */
export class UnsupportedError extends Error {
  override name = "UnsupportedError";
}

export type WireError =
  | { name: "FormatError"; reason: Reason; where: string; detail: string }
  | { name: string; message: string };

export function toWire(error: unknown): WireError {
  if (error instanceof FormatError) {
    const { reason, where, detail } = error;
    return { name: "FormatError", reason, where, detail };
  }
  if (error instanceof Error || error instanceof DOMException) return { name: error.name, message: error.message };
  return { name: "Error", message: String(error) };
}

export function fromWire(wire: WireError): Error {
  if ("reason" in wire) return new FormatError(wire.reason, wire.where, wire.detail);
  const { name, message } = wire;
  if (name === "TransportError") return new TransportError(message);
  if (name === "UnsupportedError") return new UnsupportedError(message);
  return name === "AbortError" ? aborted(message) : Object.assign(new Error(message), { name });
}

export function aborted(message = "given up"): DOMException {
  return new DOMException(message, "AbortError");
}

// The digest of a whole answer in its headers (RFC 9530): the only check of airgs.json, which no table leads to.
import { FormatError } from "../format/errors.ts";

const SHA256 = /\bsha-256=:([A-Za-z0-9+/]+=*):/;

/**
 * Throws FormatError(hash_mismatch) for bytes that are not those of the header Repr-Digest.
 *
 * One of an answer that travelled compressed is of the compressed bytes, which a page does not see: it says nothing, as one
 * without SHA-256.
 */
export async function checkReprDigest(where: string, bytes: Uint8Array, headers: Headers): Promise<void> {
  const expected = headers.has("Content-Encoding") ? null : SHA256.exec(headers.get("Repr-Digest") ?? "");
  if (!expected) return;
  const hash = await crypto.subtle.digest("SHA-256", bytes as Uint8Array<ArrayBuffer>);
  if (btoa(String.fromCharCode(...new Uint8Array(hash))) !== expected[1]) {
    throw new FormatError("hash_mismatch", where, "the SHA-256 differs from the one in the headers of the answer");
  }
}

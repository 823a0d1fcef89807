// The bytes of tables, parsed and checked against their schema: FORMAT.md, section 2.
import { MAX_ROOT_BYTES, ROOT_PATH, VERSION } from "../generated/constants.ts";
import { root as rootSchema } from "../generated/schema.ts";
import { checkTable } from "./check.ts";
import { FormatError } from "./errors.ts";
import { checkRoot } from "./references.ts";
import type { Root } from "./types.ts";

/** An airgs.json. Throws FormatError. */
export function parseRoot(bytes: Uint8Array): Root {
  if (bytes.length > MAX_ROOT_BYTES) {
    throw new FormatError("too_large", ROOT_PATH, `expected at most ${MAX_ROOT_BYTES} bytes`);
  }
  const data = parseJson(bytes, ROOT_PATH);
  checkTable(data, { type: "object" }, ROOT_PATH);
  const { version } = data as { version?: unknown };
  if (version !== VERSION) {
    throw new FormatError("unknown_version", ROOT_PATH, `expected version ${VERSION}, got ${JSON.stringify(version)}`);
  }
  checkTable(data, rootSchema, ROOT_PATH);
  const root = data as Root;
  checkRoot(root);
  return root;
}

/** A page or the table of a group, which fits `schema`, and not more than that yet. Throws FormatError. */
export function parseTable(bytes: Uint8Array, schema: Record<string, unknown>, where: string): unknown {
  const data = parseJson(bytes, where);
  checkTable(data, schema, where);
  return data;
}

function parseJson(bytes: Uint8Array, where: string): unknown {
  try {
    return JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(bytes));
  } catch (error) {
    throw new FormatError("not_json", where, `expected JSON: ${error}`);
  }
}

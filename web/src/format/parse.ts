// The bytes of tables, parsed and checked against their schema (generated/schema.ts), with no library: exactly the
// keywords that it uses. FORMAT.md, section 2. The text of a group's table is one gzip member (RFC 1952).
import { MAX_TABLE_BYTES, MAX_VALUES, ROOT_PATH, VERSION } from "../generated/constants.ts";
import { root as rootSchema } from "../generated/schema.ts";
import { concat } from "./collections.ts";
import { FormatError, type Reason } from "./errors.ts";
import { checkRoot } from "./references.ts";
import type { Root } from "./types.ts";

export function parseRoot(bytes: Uint8Array): Root {
  const data = parseTable(bytes, { type: "object" }, ROOT_PATH);
  const { version } = data as { version?: unknown };
  if (version !== VERSION) {
    throw new FormatError("unknown_version", ROOT_PATH, `expected version ${VERSION}, got ${JSON.stringify(version)}`);
  }
  checkTable(data, rootSchema, ROOT_PATH);
  const root = data as Root;
  checkRoot(root);
  return root;
}

/** A table that fits `schema`, and not more than that yet. Throws FormatError. */
export function parseTable(bytes: Uint8Array, schema: Json, where: string): unknown {
  let values = 0; // one follows each comma and opening bracket
  for (const byte of bytes) values += Number(byte === 0x2c || byte === 0x5b || byte === 0x7b);
  if (bytes.length > MAX_TABLE_BYTES || values > MAX_VALUES) {
    const detail = `expected at most ${MAX_TABLE_BYTES} bytes of JSON with ${MAX_VALUES} commas and opening brackets`;
    throw new FormatError("too_large", where, detail);
  }
  let data: unknown;
  try {
    data = JSON.parse(new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(bytes));
  } catch (error) {
    throw new FormatError("not_json", where, `expected JSON: ${error}`);
  }
  checkTable(data, schema, where);
  return data;
}

/** The bytes in a gzip member; `where` names the file. Throws FormatError (not_json, too_large). */
export async function inflate(data: Uint8Array, where: string): Promise<Uint8Array> {
  const coded = new Response(data as Uint8Array<ArrayBuffer>).body!;
  const text = await collect(coded.pipeThrough(new DecompressionStream("gzip")).getReader(), where);
  // Node's inflater takes several members, and anything behind them.
  // The last four bytes are the length of the only one.
  const length = new DataView(data.buffer, data.byteOffset + data.length - 4).getUint32(0, true);
  if (length !== text.length) throw new FormatError("not_json", where, "expected JSON in one whole gzip member");
  return text;
}

async function collect(reader: ReadableStreamDefaultReader<Uint8Array>, where: string): Promise<Uint8Array> {
  const parts: Uint8Array[] = [];
  let length = 0;
  for (;;) {
    const { done, value } = await reader.read().catch((error: unknown) => {
      throw new FormatError("not_json", where, `expected JSON in gzip: ${error}`);
    });
    if (done) return concat(Uint8Array, parts);
    length += value.length;
    if (length > MAX_TABLE_BYTES) {
      reader.cancel().catch(() => {});
      throw new FormatError("too_large", where, `expected at most ${MAX_TABLE_BYTES} bytes of JSON`);
    }
    parts.push(value);
  }
}

type Json = Record<string, unknown>;
type Keyword = (value: unknown, argument: unknown) => string | null;

const STRUCTURE = new Set(["type", "properties", "optional", "additionalProperties", "items"]);
/** Says why a value is refused as bad_value; null: it may stand. Values of another type are refused before. */
const KEYWORDS: Record<string, Keyword> = {
  const: (value, argument) => (value === argument ? null : `expected ${argument}`),
  enum: (value, words) => ((words as unknown[]).includes(value) ? null : `expected one of ${words}`),
  pattern: (value, text) =>
    new RegExp(text as string, "u").test(value as string) ? null : `expected text like ${text}`,
  range: (value, bounds) => {
    const [low, high] = bounds as [number, number];
    const size = Array.isArray(value) ? value.length : (value as number);
    return size >= low && size <= high ? null : `expected ${low} to ${high}`;
  },
};

const asked = ({ items, properties, additionalProperties, type }: Json) =>
  items ? "array" : (properties ?? additionalProperties) ? "object" : type;

const shown = (value: unknown) => (JSON.stringify(value) ?? "nothing").slice(0, 80);

/** Throws FormatError (wrong_type, unknown_field, missing_field, bad_value) unless `value` is what `schema` asks for;
 * `where` names it. Throws an Error for a keyword that is not known here.
 */
export function checkTable(value: unknown, schema: Json, where: string): void {
  const refuse = (reason: Reason, detail: string) => new FormatError(reason, where, detail);
  const type = asked(schema);
  const got = value === null ? "null" : Array.isArray(value) ? "array" : typeof value;
  if (type !== undefined && got !== (type === "integer" ? "number" : type)) {
    throw refuse("wrong_type", `expected ${type}, got ${got}`);
  }
  if (type === "integer" && !Number.isInteger(value)) throw refuse("wrong_type", `expected integer, got ${value}`);
  if (typeof value === "string" && /\p{Surrogate}/u.test(value)) {
    throw refuse("bad_value", "expected text, got half a surrogate pair");
  }
  if (typeof value === "number" && !Number.isFinite(value)) throw refuse("bad_value", "expected a finite number");
  if (Array.isArray(value)) {
    for (const [i, item] of value.entries()) checkTable(item, (schema.items ?? {}) as Json, `${where}[${i}]`);
  } else if (got === "object") checkObject(value as Json, schema, where);
  for (const [name, argument] of Object.entries(schema)) {
    if (STRUCTURE.has(name)) continue;
    const keyword = KEYWORDS[name];
    if (!keyword) throw new Error(`${where}: the schema has a keyword ${name} that is not known`);
    const wrong = keyword(value, argument);
    if (wrong !== null) throw refuse("bad_value", `${wrong}, got ${shown(value)}`);
  }
}

function checkObject(value: Json, schema: Json, where: string): void {
  const properties = (schema.properties ?? {}) as Record<string, Json>;
  const optional = schema.optional as string[] | undefined;
  const others = schema.additionalProperties;
  const strange = Object.keys(value).filter((name) => !Object.hasOwn(properties, name));
  if (schema.properties && strange.length)
    throw new FormatError("unknown_field", where, `unknown fields ${strange.slice(0, 8)}`);
  const missing = Object.keys(properties).filter((name) => !Object.hasOwn(value, name) && !optional?.includes(name));
  if (missing.length) throw new FormatError("missing_field", where, `missing fields ${missing}`);
  for (const [name, one] of Object.entries(properties)) {
    if (Object.hasOwn(value, name)) checkTable(value[name], one, `${where}.${name}`);
  }
  if (typeof others !== "object") return;
  for (const name of strange) {
    checkTable(name, {}, where);
    checkTable(value[name], others as Json, `${where}.${name}`);
  }
}

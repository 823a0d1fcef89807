// The JSON Schema of the tables (generated/schema.ts), checked with no library: exactly the keywords that it uses.
import { FormatError, type Reason } from "./errors.ts";

type Json = Record<string, unknown>;
type Keyword = (value: unknown, argument: unknown, schema: Json) => string | null;

const STRUCTURE = new Set(["type", "properties", "required", "additionalProperties", "propertyNames", "items"]);
const range = (low: unknown, high: unknown) => `expected ${low ?? "any"} to ${high ?? "any"}`;

/** What a value is refused for as bad_value; null: it may stand. Values of another type are refused before. */
const KEYWORDS: Record<string, Keyword> = {
  const: (value, argument) => (value === argument ? null : `expected ${argument}`),
  enum: (value, words) => ((words as unknown[]).includes(value) ? null : `expected one of ${words}`),
  pattern: (value, text) =>
    new RegExp(text as string, "u").test(value as string) ? null : `expected text like ${text}`,
  minimum: (value, low, s) => ((value as number) >= (low as number) ? null : range(low, s.maximum)),
  maximum: (value, high, s) => ((value as number) <= (high as number) ? null : range(s.minimum, high)),
  minItems: (list, low, s) => ((list as unknown[]).length >= (low as number) ? null : range(low, s.maxItems)),
  maxItems: (list, high, s) => ((list as unknown[]).length <= (high as number) ? null : range(s.minItems, high)),
};

/** JSON's name of a value's type. */
function typeOf(value: unknown): string {
  if (value === null) return "null";
  return Array.isArray(value) ? "array" : typeof value;
}

const shown = (value: unknown) => (JSON.stringify(value) ?? "nothing").slice(0, 80);

/**
 * Throws FormatError (wrong_type, unknown_field, missing_field, bad_value) unless `value` is what `schema` asks for;
 * `where` names it. Throws an Error for a keyword that is not known here.
 */
export function checkTable(value: unknown, schema: Json, where: string): void {
  const refuse = (reason: Reason, detail: string) => new FormatError(reason, where, detail);
  checkType(value, schema.type, refuse);
  if (typeof value === "number" && !Number.isFinite(value)) throw refuse("bad_value", "expected a finite number");
  if (Array.isArray(value)) {
    for (const [i, item] of value.entries()) checkTable(item, (schema.items ?? {}) as Json, `${where}[${i}]`);
  } else if (typeOf(value) === "object") checkObject(value as Json, schema, where);
  for (const [name, argument] of Object.entries(schema)) {
    if (STRUCTURE.has(name)) continue;
    const keyword = KEYWORDS[name];
    if (!keyword) throw new Error(`${where}: the schema has a keyword ${name} that is not known`);
    const wrong = keyword(value, argument, schema);
    if (wrong !== null) throw refuse("bad_value", `${wrong}, got ${shown(value)}`);
  }
}

function checkType(value: unknown, type: unknown, refuse: (reason: Reason, detail: string) => FormatError): void {
  if (type === undefined) return;
  const got = typeOf(value);
  if (got !== (type === "integer" ? "number" : type)) throw refuse("wrong_type", `expected ${type}, got ${got}`);
  if (type === "integer" && !Number.isInteger(value)) throw refuse("wrong_type", `expected integer, got ${value}`);
}

function checkObject(value: Json, schema: Json, where: string): void {
  const properties = (schema.properties ?? {}) as Record<string, Json>;
  const others = schema.additionalProperties;
  const strange = Object.keys(value).filter((name) => !Object.hasOwn(properties, name));
  if (others === false && strange.length) throw new FormatError("unknown_field", where, `unknown fields ${strange}`);
  const missing = ((schema.required ?? []) as string[]).filter((name) => !Object.hasOwn(value, name));
  if (missing.length) throw new FormatError("missing_field", where, `missing fields ${missing}`);
  for (const [name, one] of Object.entries(properties)) {
    if (Object.hasOwn(value, name)) checkTable(value[name], one, `${where}.${name}`);
  }
  if (typeof others !== "object") return;
  for (const name of strange) {
    checkTable(name, (schema.propertyNames ?? {}) as Json, where);
    checkTable(value[name], others as Json, `${where}.${name}`);
  }
}

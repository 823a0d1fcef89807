// Makes src/generated/ from manifests/airgs.schema.json: `tables.ts`, the types of the tables, and `schema.ts`, the schema
// itself without its words for people, which the player checks tables against.
import { mkdir, readFile, rename, writeFile } from "node:fs/promises";
import { compile } from "json-schema-to-typescript";

const SCHEMA = new URL("../../manifests/airgs.schema.json", import.meta.url);
const FOLDER = new URL("../src/generated/", import.meta.url);
const BANNER = "// Made from manifests/airgs.schema.json by scripts/tables.mjs.\n";

/** A schema without titles and descriptions. A property of a table may have such a name: those are kept. */
function bare(node, isProperties = false) {
  if (Array.isArray(node)) return node.map((item) => bare(item));
  if (node === null || typeof node !== "object") return node;
  const kept = Object.entries(node).filter(
    ([key]) => isProperties || !["title", "description", "$schema"].includes(key),
  );
  return Object.fromEntries(kept.map(([key, value]) => [key, bare(value, !isProperties && key === "properties")]));
}

const schema = JSON.parse(await readFile(SCHEMA, "utf8"));
const { $defs, ...root } = bare(schema);
const options = { bannerComment: "", additionalProperties: false, ignoreMinAndMaxItems: true, format: false };
const named = { Root: root, Page: $defs.page, Group: $defs.group };
const types = await Promise.all(Object.entries(named).map(([name, one]) => compile(one, name, options)));
const values = Object.entries(named).map(
  ([name, one]) => `export const ${name.toLowerCase()} = ${JSON.stringify(one)};\n`,
);
await mkdir(FOLDER, { recursive: true });
await write("tables.ts", BANNER + types.join("\n"));
await write("schema.ts", BANNER + values.join(""));

/** Writes a file if it says something else, at once: another build may be reading it. */
async function write(name, text) {
  const [path, part] = [new URL(name, FOLDER), new URL(`${name}.${process.pid}`, FOLDER)];
  if ((await readFile(path, "utf8").catch(() => null)) === text) return;
  await writeFile(part, text);
  await rename(part, path);
}

import assert from "node:assert/strict";
import { test } from "node:test";
import { FormatError } from "../../src/format/errors.ts";
import { folders, readFiles } from "./files.ts";
import { refusals } from "./refusals.ts";
import { walk } from "./walk.ts";

for (const folder of [...folders("manifests/valid"), ...folders("tests/golden")]) {
  test(`${folder} is read`, async () => {
    assert.ok((await walk(readFiles(folder))) > 1);
  });
}

/** What only the folder or the MPD shows, which a player does not read. */
const OUT_OF_SIGHT = ["bad_mpd", "doctype", "foreign_file", "foreign_url", "mpd_mismatch"];

/** Found when pictures are decoded. */
const DECODED = ["bad_picture-checksum", "bad_picture-size"];

/** What the player says elsewhere, or otherwise. */
const OTHERWISE: Record<string, { reason?: string; where?: string }> = {
  unsafe_path: { reason: "size_mismatch" }, // the link leads to another file of the package
  "bad_value-index-level": { where: "airgs.json.entries of the last level of the index" },
  count_mismatch: { where: "levels[0]" }, // found before the states are read
};

const CASES = refusals();

for (const [{ name, ...told }, files] of CASES) {
  if (OUT_OF_SIGHT.includes(told.reason) || DECODED.includes(name)) {
    test(`${name}: nothing that reading tables and files shows`, async () => {
      assert.ok((await walk(files)) > 1);
    });
    continue;
  }
  const { reason, where } = { ...told, ...OTHERWISE[name] };
  test(`${name}: ${reason} at ${where}`, async () => {
    await assert.rejects(walk(files), (error) => {
      assert.ok(error instanceof FormatError, String(error));
      assert.equal(error.reason, reason, error.message);
      assert.ok(error.where.startsWith(where), error.message);
      return true;
    });
  });
}

test("every package that is refused otherwise is there", () => {
  const [names, reasons] = [CASES.map(([{ name }]) => name), CASES.map(([{ reason }]) => reason)];
  assert.deepEqual(
    [
      ...Object.keys(OTHERWISE).filter((name) => !names.includes(name)),
      ...DECODED.filter((name) => !names.includes(name)),
      ...OUT_OF_SIGHT.filter((reason) => !reasons.includes(reason)),
    ],
    [],
  );
});

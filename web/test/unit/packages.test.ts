import assert from "node:assert/strict";
import { test } from "node:test";
import { FormatError } from "../../src/format/errors.ts";
import { folders } from "./files.ts";
import { walk } from "./walk.ts";

for (const folder of [...folders("manifests/valid"), ...folders("tests/golden")]) {
  test(`${folder} is read`, async () => {
    assert.ok((await walk(folder)) > 1);
  });
}

/** What only the folder or the MPD shows, which a player does not read: what it finds in the package instead. */
const OUT_OF_SIGHT: Record<string, string | null> = {
  bad_mpd: null,
  doctype: null,
  foreign_file: null,
  "foreign_file-page": null,
  "foreign_file-tile": null,
  foreign_url: null,
  mpd_mismatch: null,
  "mpd_mismatch-live": null,
  unsafe_path: "size_mismatch", // the link leads to another file of the package
};

for (const folder of folders("manifests/invalid")) {
  const name = folder.split("/").at(-1)!;
  const reason = name in OUT_OF_SIGHT ? OUT_OF_SIGHT[name]! : name.split("-")[0]!;
  test(`${folder}: ${reason ?? "nothing that a player sees"}`, async () => {
    if (reason === null) {
      await walk(folder);
      return;
    }
    await assert.rejects(walk(folder), (error) => {
      assert.ok(error instanceof FormatError, String(error));
      assert.equal(error.reason, reason, error.message);
      return true;
    });
  });
}

test("every package out of sight is there", () => {
  const names = folders("manifests/invalid").map((folder) => folder.split("/").at(-1)!);
  assert.deepEqual(
    Object.keys(OUT_OF_SIGHT).filter((name) => !names.includes(name)),
    [],
  );
});

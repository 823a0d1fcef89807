"""Write the cases of manifests/invalid: packages with one thing broken, each refused for one reason.

    python -m tests.makers.refusals

A case is a package of manifests/valid with changes: `moving`, or `paged` for what concerns a page, `kept` for
differences. Its name begins with the reason; where a reader finds it is what `validate` says. How
cases are written is told in manifests/invalid/README.md.
"""

from __future__ import annotations

import base64
import difflib
import gzip
import json
import re
from dataclasses import replace
from typing import Any

import numpy as np

from airgs_codec.coding.rangecoder import encode_columns
from airgs_codec.coding.sidecar import pack_keyframe_sidecar, unpack_keyframe_sidecar
from airgs_codec.media.mp4 import box, read_boxes, read_segment, sound_segment, with_own_box
from tests.faces import JSON_NAME, MAX_TABLE_BYTES, MPD_NAME, Grid, digest, parse_root
from tests.support import mutations
from tests.support.mutations import Files, apply, drop_value, honest, parse_table, remove_file, rewrite, set_value
from tests.support.paths import INVALID
from tests.support.refusals import Case, base_files, findings

KEYFRAME_SIDECAR, INTER_SIDECAR = (f"keyframe/T0/{number}.bin" for number in (1, 2))
KEYFRAME_PICTURE, DELTAS, PAGE_TABLE = "keyframe/T0/Q0/1.m4s", "delta/L0/1.m4s", "index/1/1.json"
TABLE, INTER_TABLE, LAST_TABLE = (f"group/{number}.json.gz" for number in (1, 2, 3))
NONE = {"bytes": 0, "sha256": ""}
LEVEL = ("segments", 0, "levels", 0)
MIRROR = [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 0]
NO_SPANS = {"frames": [], "segments": [], "bytes": [], "sha256": ""}


def without_moving_rows(files: Files) -> Files:
    """Say in a sidecar that its rows are static, while the tables count them."""
    group, coarsest = parse_table(files[TABLE]), parse_root(files[JSON_NAME]).qualities[-1].coarser
    grid = Grid(**group["grid"])
    sidecar = unpack_keyframe_sidecar(
        files[KEYFRAME_SIDECAR], group["tiers"][0]["count"], grid, coarsest, KEYFRAME_SIDECAR
    )
    still = replace(sidecar, depths=np.full_like(sidecar.depths, 255))
    return files | {KEYFRAME_SIDECAR: pack_keyframe_sidecar(still, grid, coarsest)}


def inter_sidecar(files: Files) -> Files:
    """Give all rows of the second group, which keeps those of the first, the depth 255."""
    count = parse_table(files[INTER_TABLE])["tiers"][0]["count"]
    return files | {INTER_SIDECAR: encode_columns([(np.full(count, 256), 1)])}


def flip(data: bytes, at: int = -1) -> bytes:
    return data[:at] + bytes([data[at] ^ 1]) + data[at:][1:]


def in_table(*steps: mutations.Mutation) -> tuple[mutations.Mutation, ...]:
    """Changes to the table of the first group, of which the index knows."""
    return (*steps, mutations.reindexed)


def fragment_of(data: bytes) -> bytes:
    return b"".join(whole for kind, whole in read_boxes(data) if kind != b"uuid")


def with_columns(data: bytes, columns: bytes | None, change: int = 0) -> bytes:
    """A media segment with other columns, and with a change of its first checksum."""
    first, *others = read_segment(data).checksums
    return with_own_box(fragment_of(data), [first ^ change, *others], columns or b"")


def repaged(files: Files) -> Files:
    """Make airgs.json agree with the length and digest of the first page."""
    page = files[PAGE_TABLE]
    return apply(files, set_value(("index", 1, "bytes"), [len(page)]), set_value(("index", 1, "sha256"), digest(page)))


def unpaged(files: Files) -> Files:
    """Put the groups of the first page into airgs.json, before those that are there."""
    page, index = parse_table(files[PAGE_TABLE]), parse_table(files[JSON_NAME])["index"]
    groups = {name: page[name] + index[0][name] for name in page}
    return apply(files, set_value(("index",), [groups]), remove_file(PAGE_TABLE))


def raised(files: Files) -> Files:
    """Say of the first page that it is one of the second level."""
    groups, pages = parse_table(files[JSON_NAME])["index"]
    page = mutations.add_file("index/2/1.json", files[PAGE_TABLE])
    return apply(files, set_value(("index",), [groups, NO_SPANS, pages]), remove_file(PAGE_TABLE), page)


def shortened(files: Files) -> Files:
    """Make one group of the first two on the first page, whose sums stay as they are."""
    page = parse_table(files[PAGE_TABLE])
    sums = {name: [sum(page[name][:2]), *page[name][2:]] for name in ("frames", "segments")}
    entries = {"bytes": page["bytes"][1:], "sha256": page["sha256"][32:]}
    return repaged(files | {PAGE_TABLE: mutations.pack_table(PAGE_TABLE, sums | entries)})


BREAKS: dict[str, tuple[mutations.Mutation, ...]] = {  # reason, and what about -> what breaks the valid package
    "too_large": (rewrite(JSON_NAME, lambda text: text.ljust(MAX_TABLE_BYTES + 1)),),
    "not_json": (rewrite(JSON_NAME, lambda text: text[:-1]),),
    "not_json-group": in_table(rewrite(TABLE, gzip.decompress)),
    "not_json-group-tail": in_table(rewrite(TABLE, lambda data: data + data)),
    "unknown_version": (set_value(("version",), 1),),
    "unknown_field": (set_value(("colour",), "red"),),
    "unknown_field-group": in_table(set_value(("colour",), "red", TABLE)),
    "missing_field": (drop_value(("frames",)),),
    "missing_field-world": (set_value(("world",), {"transform": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]}),),
    "missing_field-group": in_table(drop_value(("grid",), TABLE)),
    "wrong_type": (set_value(("frames",), "4"),),
    "wrong_type-world": (set_value(("world",), None),),
    "wrong_type-index": (mutations.edit_tables(lambda root: root.update(index={"groups": root["index"][0]})),),
    "wrong_type-live": (set_value(("live",), 1),),
    "wrong_type-group": in_table(set_value(("count",), None, TABLE)),
    "bad_value": (set_value(("sh_degree",), 4),),
    "bad_value-world": (set_value(("world",), {"transform": [1, 0, 0, 0, 0, 2, 0, 0, 0, 0, 1, 0], "metric": True}),),
    "bad_value-world-mirror": (set_value(("world",), {"transform": MIRROR, "metric": False}),),
    "bad_value-name": (set_value(("region", "places", 0, "name"), ""),),
    "bad_value-name-long": (set_value(("region", "places", 0, "name"), 65 * "a"),),
    "bad_value-background": (set_value(("region", "background"), [1, 1, 1.5]),),
    "bad_value-background-length": (set_value(("region", "background"), [1, 1]),),
    "bad_value-columns": (set_value(("index", 0, "frames"), [2, 2]),),
    "bad_value-index": (set_value(("index",), []),),
    "bad_value-index-level": (mutations.edit_tables(lambda root: root["index"].append(NO_SPANS)),),
    "bad_value-cover": (set_value(("frames",), 5),),
    "bad_value-page-root": (set_value(("index", 0), NO_SPANS),),
    "bad_value-page-full": (unpaged,),
    "bad_value-page-level": (raised,),
    "bad_value-page-short": (shortened,),
    "bad_value-group": in_table(set_value(("start",), 1, TABLE)),
    "wrong_type-slopes-flag": in_table(set_value((*LEVEL, "slopes"), 1, TABLE)),
    "bad_value-slopes-flag-none": in_table(
        set_value((*LEVEL, "file"), NONE, TABLE), set_value((*LEVEL, "frame_bytes"), [], TABLE), remove_file(DELTAS)
    ),
    "bad_picture-slopes-flag": (
        drop_value((*LEVEL, "slopes"), TABLE),
        rewrite(DELTAS, lambda b: with_columns(b, b"")),
        honest,
    ),
    "bad_sidecar-slopes-flag": in_table(drop_value((*LEVEL, "slopes"), TABLE)),
    "bad_sidecar-slopes": in_table(set_value((*LEVEL, "slopes"), True, TABLE)),
    "bad_value-rungs": (set_value(("rungs", 0), []),),
    "bad_value-tiers": (set_value(("tiers",), 3),),
    "bad_value-levels": in_table(set_value(("levels",), [], TABLE)),
    "bad_value-frame-bytes": in_table(set_value((*LEVEL, "frame_bytes"), [], TABLE)),
    "bad_value-segments": in_table(set_value(("segments", 0, "stop"), 3, TABLE)),
    "bad_value-page-sum": (set_value(("frames", 0), 2, PAGE_TABLE), repaged),
    "bad_value-base": in_table(set_value(("base",), 2, INTER_TABLE)),
    "bad_value-base-chain": in_table(set_value(("base",), 2, LAST_TABLE)),
    "bad_value-base-grid": in_table(set_value(("grid", "step"), 0.5, INTER_TABLE)),
    "bad_value-base-steps": in_table(set_value(("keyframe_steps", "opacity"), 0.5, INTER_TABLE)),
    "bad_value-base-transform": in_table(set_value(("colour_transform",), "AAAAAAAAAAAAAAAAAAAAAAAA", INTER_TABLE)),
    "bad_value-base-finest": in_table(set_value(("grid", "finest"), 148, INTER_TABLE)),
    "bad_value-base-factor": in_table(set_value(("tiers", 0, "factor"), 2.5, INTER_TABLE)),
    "bad_value-base-rows": in_table(set_value(("tiers", 0, "qualities", 0, "rows"), 1, INTER_TABLE)),
    "missing_entry-base": in_table(set_value(("tiers", 0, "pictures", 0), NONE, INTER_TABLE)),
    "bad_sidecar-inter": (inter_sidecar, honest),
    "bad_sidecar-inter-positions": (lambda files: files | {INTER_SIDECAR: files[KEYFRAME_SIDECAR]}, honest),
    "unsafe_path": (mutations.link_file(KEYFRAME_SIDECAR, "Q0/1.m4s"),),
    "missing_entry": in_table(set_value(("tiers", 0, "pictures", 0), NONE, TABLE), remove_file(KEYFRAME_PICTURE)),
    "missing_file": (remove_file(KEYFRAME_PICTURE),),
    "missing_file-group": (remove_file(TABLE),),
    "missing_file-page": (remove_file(PAGE_TABLE),),
    "foreign_file-page": (mutations.add_file("index/2/1.json", b"nothing leads to it\n"),),
    "foreign_file": (mutations.add_file("notes.txt", b"not part of the package\n"),),
    "size_mismatch": (rewrite(KEYFRAME_SIDECAR, lambda b: b + b"\0"),),
    "size_mismatch-group": (rewrite(TABLE, lambda b: b + b"\0"),),
    "hash_mismatch": (rewrite(KEYFRAME_SIDECAR, flip),),
    "hash_mismatch-group": (rewrite(TABLE, flip),),
    "hash_mismatch-page": (rewrite(PAGE_TABLE, lambda b: flip(b, -3)),),
    "bad_sound": (rewrite("sound/1.m4a", lambda b: b[: len(b) // 2]), honest),
    "bad_sound-packets": (rewrite("sound/1.m4a", lambda _: sound_segment([bytes([255] * 4)], 0)), honest),
    "bad_value-sound": in_table(drop_value(("sound",), TABLE)),
    "missing_entry-sound": in_table(set_value(("sound",), NONE, TABLE)),
    "missing_entry-sound-init": (set_value(("sound", "init"), NONE),),
    "bad_sidecar": (rewrite(KEYFRAME_SIDECAR, lambda b: b[: len(b) // 2]), honest),
    "bad_sidecar-detail": (rewrite(KEYFRAME_PICTURE, lambda b: with_columns(b, bytes(20))), honest),
    "count_mismatch": (without_moving_rows, honest),
    "bad_picture": (rewrite(KEYFRAME_PICTURE, lambda b: b[:-40] + bytes(20)), honest),
    "bad_picture-uuid": (rewrite(KEYFRAME_PICTURE, lambda b: box(b"uuid", bytes(20)) + fragment_of(b)), honest),
    "bad_picture-checksum": (rewrite(KEYFRAME_PICTURE, lambda b: with_columns(b, read_segment(b).columns, 1)), honest),
    "bad_picture-no-checksum": (rewrite(KEYFRAME_PICTURE, fragment_of), honest),
    "bad_value-picture-width": in_table(set_value(("tiers", 0, "qualities", 0, "width"), 4096, TABLE)),
    "bad_picture-size": in_table(set_value(("tiers", 0, "qualities", 0, "height"), 4096, TABLE)),
    "doctype": (mutations.edit_text(MPD_NAME, "<MPD", '<!DOCTYPE MPD [<!ENTITY a "b">]><MPD'),),
    "bad_mpd": (mutations.edit_text(MPD_NAME, "</MPD>", ""),),
    "foreign_url": (mutations.edit_text(MPD_NAME, 'media="delta/', 'media="http://example.com/delta/'),),
    "mpd_mismatch": (mutations.edit_text(MPD_NAME, '<S t="0"', '<S t="1"'),),
    "mpd_mismatch-live": (set_value(("live",), True),),
}


def source_of(name: str) -> str:
    if "sound" in name:
        return "sound"
    if "-slopes-flag" in name:
        return "slopes"
    if "-page" in name:
        return "paged"
    return "inter" if re.search("-base|-inter|^bad_sidecar-slopes$", name) else "moving"


def changes(name: str) -> dict[str, dict[str, Any] | None]:
    """Path -> what becomes of the file, of every file that a case changes."""
    before = base_files(source_of(name))
    after = apply(before, *BREAKS[name])
    paths = sorted(path for path in before.keys() | after.keys() if before.get(path) != after.get(path))
    return {path: change(before.get(path), after.get(path)) for path in paths}


def change(before: bytes | None, after: bytes | None) -> dict[str, Any] | None:
    """What a case says of a file: whole, if it is not text that was there."""
    if after is None:
        return None
    if isinstance(after, mutations.Link):
        return {"link": after.decode()}
    if before is None or not before.isascii():
        return {"data": base64.b64encode(after).decode()}
    if after == before.ljust(len(after)):
        return {"spaces_to": len(after)}
    return {"replace": replacements(before.decode(), after.decode())}


def replacements(before: str, after: str) -> list[list[str]]:
    """Texts and what takes their places, one after the other; each is there once when its turn comes."""
    old, new = (re.findall(r'"[^"]*"|[\w.+-]+|.|\n', text) for text in (before, after))
    found, text = [], before
    for kind, i, i_end, j, j_end in difflib.SequenceMatcher(None, old, new, autojunk=False).get_opcodes():
        if kind == "equal":
            continue
        was, becomes = "".join(old[i:i_end]), "".join(new[j:j_end])
        while was[:1] != '"' or text.count(was) != 1:  # from a name on; all before it is as in `new` by now
            j -= 1
            was, becomes = new[j] + was, new[j] + becomes
        found.append([was, becomes])
        text = text.replace(was, becomes)
    return found


def main() -> None:
    """Write the cases anew, those of a base package in one file, a line each."""
    for path in INVALID.glob("*.json"):
        path.unlink()
    lines: dict[str, list[str]] = {}
    for name in BREAKS:
        case = Case(source_of(name), name, name.split("-")[0], "", changes(name))
        where = findings(case.package())[0].where.removeprefix("package/")
        table = {"name": name, "reason": case.reason, "where": where, "files": case.files}
        lines.setdefault(case.base, []).append(json.dumps(table, separators=(",", ":")))
    for base, cases in lines.items():
        (INVALID / f"{base}.json").write_text('{"cases": [\n' + ",\n".join(cases) + "\n]}\n")


if __name__ == "__main__":
    main()

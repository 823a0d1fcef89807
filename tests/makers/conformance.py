"""Write the conformance corpus: manifests/valid/<name>/ and manifests/invalid/<reason>/, small whole packages.

    python -m tests.makers.conformance

Every package under invalid/ is valid/moving with one thing broken, and must be refused for the reason it is named
after. Encoder bytes may change from one x264 to the next; what the packages decode to is pinned in tests/golden.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from airgs_codec.coding.sidecar import pack_key_sidecar, unpack_key_sidecar
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings, LevelSettings
from airgs_codec.package.parse import parse_manifest
from airgs_codec.package.tables import JSON_NAME, MPD_NAME
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import open_sequence
from tests.support.mutations import (
    Files,
    Mutation,
    add_file,
    drop_value,
    edit_tables,
    edit_text,
    honest,
    on_disk,
    remove_file,
    rewrite,
    set_value,
)
from tests.support.paths import INVALID, VALID
from tests.support.scenes import write_sequence

KEY_SIDECAR, KEY_PICTURE, STATE_SIDECAR = "key/T0/1.bin", "key/T0/Q0/1.m4s", "state/L0/1.bin"
SETTINGS = EncodeSettings(calibrate="none", levels=(LevelSettings(0.0),))


def frames(count: int, degree: int, length: int) -> list[Gaussians]:
    """A small ball of Gaussians, half of it swinging."""
    rng = np.random.default_rng(7)
    rest = rng.normal(size=(count, {0: 0, 1: 3}[degree], 3)) * 0.2
    still = rng.normal(size=(count, 3)) * 0.4
    columns = [rng.normal(size=(count, 4)), rng.normal(size=(count, 3)) * 0.3 - 2, rng.normal(size=count) * 2]
    columns += [rng.normal(size=(count, 3)), rest]
    swing = (np.arange(count) % 2)[:, None] * np.array([0.2, 0.05, 0.0])
    moved = [still + swing * np.sin(0.5 * t) for t in range(length)]
    return [Gaussians(*(np.asarray(c, np.float32) for c in (means, *columns))) for means in moved]


PACKAGES = {
    "moving": (frames(64, 0, 4), replace(SETTINGS, levels=(LevelSettings(0.0), LevelSettings(0.5, 2.0, quality=1)))),
    "one-gaussian": (frames(1, 1, 1), replace(SETTINGS, key_factors=(1.0,))),
    "two-groups-sh1": (frames(40, 1, 5), replace(SETTINGS, group_frames=3, segment_s=0.07)),
}


def without_moving_rows(files: Files) -> Files:
    """Say in a sidecar that its rows are static, while the tables count them."""
    m = parse_manifest(files[JSON_NAME])
    group, coarsest = m.groups[0], m.qualities[-1].coarser
    sidecar = unpack_key_sidecar(files[KEY_SIDECAR], group.tiers[0].count, group.grid, coarsest, KEY_SIDECAR)
    still = replace(sidecar, depths=np.full_like(sidecar.depths, 255))
    return files | {KEY_SIDECAR: pack_key_sidecar(still, group.grid, coarsest)}


def flip(data: bytes) -> bytes:
    """Change the last byte."""
    return data[:-1] + bytes([data[-1] ^ 1])


BREAKS: dict[str, tuple[Mutation, ...]] = {  # reason -> what breaks valid/moving
    "not_json": (rewrite(JSON_NAME, lambda text: json.dumps(json.loads(text))[:-1].encode()),),
    "unknown_version": (set_value(("version",), 2),),
    "unknown_field": (set_value(("colour",), "red"),),
    "missing_field": (drop_value(("frames",)),),
    "wrong_type": (set_value(("frames",), "4"),),
    "bad_value": (set_value(("sh_degree",), 4),),
    "unsafe_path": (edit_tables(lambda t: t["files"].update({"../outside.bin": t["files"][KEY_SIDECAR]})),),
    "missing_entry": (drop_value(("files", STATE_SIDECAR)),),
    "missing_file": (remove_file(KEY_PICTURE),),
    "foreign_file": (add_file("notes.txt", b"not part of the package\n"),),
    "size_mismatch": (rewrite(KEY_SIDECAR, lambda b: b + b"\0"),),
    "hash_mismatch": (rewrite(KEY_SIDECAR, flip),),
    "bad_sidecar": (rewrite(KEY_SIDECAR, lambda b: b[: len(b) // 2]), honest),
    "count_mismatch": (without_moving_rows, honest),
    "bad_picture": (rewrite(KEY_PICTURE, lambda b: b[:-40] + bytes(20)), honest),
    "doctype": (edit_text(MPD_NAME, "<MPD", '<!DOCTYPE MPD [<!ENTITY a "b">]><MPD'),),
    "bad_mpd": (edit_text(MPD_NAME, "</MPD>", ""),),
    "foreign_url": (edit_text(MPD_NAME, 'media="state/', 'media="http://example.com/state/'),),
    "mpd_mismatch": (edit_text(MPD_NAME, '<S t="0"', '<S t="1"'),),
}


def main() -> None:
    """Write the corpus anew."""
    shutil.rmtree(VALID, ignore_errors=True)
    shutil.rmtree(INVALID, ignore_errors=True)
    for name, (sequence, settings) in PACKAGES.items():
        with tempfile.TemporaryDirectory() as folder:
            encode(open_sequence(write_sequence(Path(folder), sequence)), VALID / name, settings)
    for reason, mutations in BREAKS.items():
        on_disk(shutil.copytree(VALID / "moving", INVALID / reason), *mutations)


if __name__ == "__main__":
    main()

"""Validation: everything wrong is a finding with its reason, nothing raises, whatever the bytes are."""

import dataclasses
import json
import os
import random
import shutil
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from airgs_codec.coding.sidecar import pack_key_sidecar, unpack_key_sidecar
from airgs_codec.inspect.validate import validate
from airgs_codec.media.h264 import ClosedGop, encode_stream, key_codec
from airgs_codec.package.store import open_package
from airgs_codec.package.tables import JSON_NAME
from tests.support.mutations import (
    add_file,
    by_chance,
    edit_tables,
    honest,
    on_disk,
    random_tables,
    set_value,
)
from tests.support.paths import VALID


@pytest.fixture
def package(tmp_path):
    return shutil.copytree(VALID / "moving", tmp_path / "package")


def replace_file(package: Path, relative: str, data: bytes) -> None:
    """Write a file and make its entry agree, so that only its content can be refused."""
    listed = edit_tables(lambda tables: tables["files"].setdefault(relative, {}))
    on_disk(package, add_file(relative, data), listed, honest)


def reasons(package: Path) -> set[str]:
    findings = validate(package)
    assert all("\n" not in str(f) for f in findings)
    return {f.reason for f in findings}


def test_a_folder_that_is_no_package(tmp_path):
    (tmp_path / "file").write_text("x")
    assert reasons(tmp_path) == reasons(tmp_path / "missing") == reasons(tmp_path / "file") == {"missing_file"}


def test_every_broken_file_has_its_own_finding(package):
    listed = sorted(json.loads((package / "airgs.json").read_text())["files"])
    for relative in listed:
        (package / relative).unlink()
    assert [(f.reason, f.where) for f in validate(package)] == [("missing_file", relative) for relative in listed]


def test_links_are_refused_wherever_they_lead(package, tmp_path):
    media = package / "state/L0/1.m4s"
    media.rename(tmp_path / "elsewhere.m4s")
    media.symlink_to(tmp_path / "elsewhere.m4s")
    (package / "folder").symlink_to(tmp_path)
    found = {(f.reason, f.where) for f in validate(package)}
    assert found == {("unsafe_path", "state/L0/1.m4s"), ("unsafe_path", "folder")}


def test_what_is_neither_file_nor_folder_is_foreign(package):
    os.mkfifo(package / "pipe")
    assert [(f.reason, f.where) for f in validate(package)] == [("foreign_file", "pipe")]


def test_a_listed_file_without_a_table_is_foreign(package):
    (package / "state/L7").mkdir()
    (package / "state/L7/1.bin").touch()
    replace_file(package, "state/L7/1.bin", b"x")
    assert reasons(package) == {"foreign_file"}


@pytest.mark.parametrize("level", [0, 1])
def test_every_level_is_decoded(package, level):
    relative = f"state/L{level}/1.bin"
    replace_file(package, relative, b"\0" * 20)
    assert [(f.reason, f.where) for f in validate(package)] == [("bad_sidecar", relative)]


@pytest.mark.parametrize("quality", [0, 1])
def test_every_key_quality_is_decoded(package, quality):
    relative = f"key/T1/Q{quality}/1.m4s"
    replace_file(package, relative, (package / relative).read_bytes()[:-30])
    assert [(f.reason, f.where) for f in validate(package)] == [("bad_picture", relative)]


@pytest.mark.parametrize("quality", [0, 1])
def test_the_positions_of_every_key_quality_are_read(package, quality):
    relative = f"key/T1/Q{quality}/1.bin"
    replace_file(package, relative, b"\0" * 20)
    assert [(f.reason, f.where) for f in validate(package)] == [("bad_sidecar", relative)]


@pytest.mark.parametrize("coarser", [0, 2, 3])
def test_cells_that_the_files_do_not_have_are_refused(package, coarser):
    assert open_package(package).manifest.qualities[1].coarser == 1
    on_disk(package, set_value(("qualities", 1, "coarser"), coarser))
    assert "bad_sidecar" in reasons(package)


def test_luma_outside_the_limited_range_is_refused(package):
    picture = open_package(package).manifest.key_pictures[0][0]
    bright = ClosedGop([np.full((picture.height, picture.width), 240, np.uint8)], 0, 1000)
    stream = encode_stream([bright], (picture.width, picture.height), Fraction(24), 24000, key_codec("veryfast"))
    replace_file(package, "key/T0/Q0/1.m4s", stream.media[0])
    replace_file(package, "key/T0/Q0/init.mp4", stream.init)
    (finding,) = validate(package)
    assert finding.reason == "bad_picture" and "16 to 235" in str(finding)


def test_more_pictures_than_promised_are_refused(package):
    replace_file(package, "key/T0/Q0/1.m4s", (package / "state/L0/1.m4s").read_bytes())
    replace_file(package, "key/T0/Q0/init.mp4", (package / "state/L0/init.mp4").read_bytes())
    assert "bad_picture" in reasons(package)


@pytest.mark.parametrize(
    ("field", "value", "reason"),
    [
        ("ssim", [], "bad_value"),
        ("psnr", [-1e300, 40.0], "bad_value"),
        ("ssim", [0.9, 7.0], "bad_value"),
        ("delta_e", [0.5], "bad_value"),
        ("delta_e", [0.5, 1e300], "bad_value"),
        ("frame_bytes", [10**9] * 4, "size_mismatch"),
        ("frame_bytes", [-5, 1, 1, 1], "bad_value"),
    ],
)
def test_what_the_tables_claim_of_a_segment_is_checked(package, field, value, reason):
    assert open_package(package).manifest.segments[0].levels[0].psnr
    on_disk(package, set_value(("segments", 0, "levels", 0, field), value))
    assert reasons(package) == {reason}


def test_steps_that_decode_to_no_finite_number_are_refused(package):
    steps = {("key_steps", "log_scales"): 1e30, ("key_steps", "quaternions"): 1e30}
    factors = [set_value(("qualities", q, "factor"), 1e6) for q in (0, 1)]
    coarse = [set_value(("groups", 0, *place), value) for place, value in steps.items()]
    on_disk(package, *coarse, *factors, set_value(("key_gain",), 1e-3))
    assert reasons(package) == {"bad_value"}


def test_a_number_that_fits_no_array_is_refused(package):
    on_disk(package, set_value(("groups", 0, "levels", 1, "centres", 0), 1 << 31))
    assert reasons(package) == {"bad_value"}


def test_a_group_without_keys_is_refused(package):
    def forget(tables):
        for tier in tables["groups"][0]["tiers"]:
            tier["number"] = 0
        tables["files"] = {path: entry for path, entry in tables["files"].items() if path.endswith("init.mp4")}
        for segment in tables["segments"]:
            for level in segment["levels"]:
                level.update(number=0, frame_bytes=[])

    on_disk(package, edit_tables(forget))
    found = validate(package)
    assert found and {f.reason for f in found} <= {"foreign_file", "mpd_mismatch", "bad_value"}


def test_one_broken_quality_does_not_hide_another_group(tmp_path):
    package = shutil.copytree(VALID / "two-groups-sh1", tmp_path / "package")
    for relative in ("key/T0/1.bin", "key/T0/2.bin"):
        replace_file(package, relative, b"\0" * 20)
    assert {f.where for f in validate(package)} == {"key/T0/1.bin", "key/T0/2.bin"}


def test_depths_that_disagree_with_a_level_are_counted(package):
    opened = open_package(package)
    group, coarsest = opened.manifest.groups[0], opened.manifest.qualities[-1].coarser
    sidecar = unpack_key_sidecar(opened.read("key/T0/1.bin"), group.tiers[0].count, group.grid, coarsest, "")
    lower = dataclasses.replace(sidecar, depths=np.minimum(sidecar.depths, 0))
    replace_file(package, "key/T0/1.bin", pack_key_sidecar(lower, group.grid, coarsest))
    assert reasons(package) == {"count_mismatch"}


@pytest.mark.parametrize("name", ["moving", "two-groups-sh1", "one-gaussian"])
def test_random_damage_is_found_or_harmless_and_never_raises(name, tmp_path):
    """Digests are made to agree, so that only decoding stands between the damage and a caller."""
    chance = random.Random(name)
    seen = set()
    for number in range(60):
        package = shutil.copytree(VALID / name, tmp_path / str(number))
        seen |= reasons(on_disk(package, by_chance(chance, tables=False), honest))
    assert {"bad_picture", "bad_sidecar"} <= seen


@pytest.mark.parametrize("name", ["moving", "two-groups-sh1"])
def test_random_changes_of_the_tables_never_raise(name, tmp_path):
    package = shutil.copytree(VALID / name, tmp_path / "package")
    chance = random.Random(name)
    text = (package / JSON_NAME).read_bytes()
    seen = set()
    for _ in range(150):
        (package / JSON_NAME).write_bytes(random_tables(chance, text))
        seen |= reasons(package)
    assert {"bad_value", "wrong_type", "missing_field"} <= seen

"""Validation: everything wrong is a finding with its reason, nothing raises, whatever the bytes are."""

import dataclasses
import os
import random
import shutil
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from airgs_codec.coding.sidecar import pack_key_sidecar, unpack_key_sidecar
from airgs_codec.inspect.validate import validate
from airgs_codec.media.fragments import with_columns
from airgs_codec.media.h264 import ClosedGop, encode_gop, key_codec
from airgs_codec.media.mp4 import read_segment
from airgs_codec.package.paths import JSON_NAME, FileKind, file_kind
from airgs_codec.package.store import open_package
from tests.makers.conformance import TABLE, media_alone
from tests.support.mutations import (
    add_file,
    by_chance,
    edit_tables,
    honest,
    on_disk,
    random_tables,
    read_files,
    reindexed,
    set_value,
)
from tests.support.paths import VALID


@pytest.fixture
def package(tmp_path):
    return shutil.copytree(VALID / "moving", tmp_path / "package")


def replace_file(package: Path, relative: str, data: bytes) -> None:
    """Write a file and make its entry agree, so that only its content can be refused."""
    on_disk(package, add_file(relative, data), honest)


def reasons(package: Path) -> set[str]:
    findings = validate(package)
    assert all("\n" not in str(f) for f in findings)
    return {f.reason for f in findings}


def test_a_folder_that_is_no_package(tmp_path):
    (tmp_path / "file").write_text("x")
    assert reasons(tmp_path) == reasons(tmp_path / "missing") == reasons(tmp_path / "file") == {"missing_file"}


def test_every_broken_file_has_its_own_finding(package):
    listed = sorted(p for p in open_package(package).manifest.files() if file_kind(p) is not FileKind.MANIFESTS)
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


@pytest.mark.parametrize("level", [0, 1])
def test_every_level_is_decoded(package, level):
    relative = f"state/L{level}/1.m4s"
    replace_file(package, relative, with_columns(media_alone((package / relative).read_bytes()), bytes(20)))
    assert [(f.reason, f.where) for f in validate(package)] == [("bad_sidecar", relative)]


@pytest.mark.parametrize("quality", [0, 1])
def test_every_key_quality_is_decoded(package, quality):
    relative = f"key/T1/Q{quality}/1.m4s"
    replace_file(package, relative, (package / relative).read_bytes()[:-30])
    assert [(f.reason, f.where) for f in validate(package)] == [("bad_picture", relative)]


@pytest.mark.parametrize("quality", [0, 1])
def test_the_positions_of_every_key_quality_are_read(package, quality):
    relative = f"key/T1/Q{quality}/1.m4s"
    replace_file(package, relative, with_columns(media_alone((package / relative).read_bytes()), bytes(20)))
    assert [(f.reason, f.where) for f in validate(package)] == [("bad_sidecar", relative)]


@pytest.mark.parametrize("coarser", [0, 2, 3])
def test_cells_that_the_files_do_not_have_are_refused(package, coarser):
    assert open_package(package).manifest.qualities[1].coarser == 1
    on_disk(package, set_value(("qualities", 1, "coarser"), coarser))
    assert "bad_sidecar" in reasons(package)


def test_luma_outside_the_limited_range_is_refused(package):
    picture = open_package(package).manifest.groups[0].units[0].qualities[0]
    bright = ClosedGop([np.full((picture.height, picture.width), 240, np.uint8)], 0, 1000)
    coded = encode_gop(bright, (picture.width, picture.height), Fraction(24), key_codec("veryfast"))
    columns = read_segment((package / "key/T0/Q0/1.m4s").read_bytes()).columns or b""
    replace_file(package, "key/T0/Q0/1.m4s", with_columns(coded.media, columns))
    (finding,) = validate(package)
    assert finding.reason == "bad_picture" and "16 to 235" in str(finding)


def test_more_pictures_than_promised_are_refused(package):
    key, state = ((package / path).read_bytes() for path in ("key/T0/Q0/1.m4s", "state/L0/1.m4s"))
    columns = read_segment(key).columns or b""
    replace_file(package, "key/T0/Q0/1.m4s", with_columns(media_alone(state), columns))
    assert "bad_picture" in reasons(package)


@pytest.mark.parametrize(
    ("field", "value", "reason"),
    [
        ("ssim", [], "bad_value"),
        ("psnr", [-1e300, 40.0], "bad_value"),
        ("ssim", [0.9, 7.0], "bad_value"),
        ("delta_e", [0.5], "bad_value"),
        ("delta_e", [0.5, 1e300], "bad_value"),
        ("frame_bytes", [[10**9] * 4], "size_mismatch"),
        ("frame_bytes", [[-5, 1, 1, 1]], "bad_value"),
    ],
)
def test_what_the_tables_claim_of_a_segment_is_checked(package, field, value, reason):
    assert open_package(package).manifest.segments[0].levels[0].psnr
    on_disk(package, set_value(("segments", 0, "levels", 0, field), value, TABLE), reindexed)
    assert reasons(package) == {reason}


def test_steps_that_decode_to_no_finite_number_are_refused(package):
    steps = {("key_steps", "log_scales"): 1e30, ("key_steps", "quaternions"): 1e30}
    factors = [set_value(("qualities", q, "factor"), 1e6) for q in (0, 1)]
    coarse = [set_value(place, value, TABLE) for place, value in steps.items()]
    on_disk(package, *coarse, *factors, set_value(("key_gain",), 1e-3), reindexed)
    assert reasons(package) == {"bad_value"}


def test_a_number_that_fits_no_array_is_refused(package):
    on_disk(package, set_value(("tiles", 0, "levels", 1, "centres", 0), 1 << 31, TABLE), reindexed)
    assert reasons(package) == {"bad_value"}


def test_a_group_without_keys_is_refused(package):
    def forget(table):
        for tier in table["tiles"][0]["tiers"]:
            for entry in (tier["sidecar"], *tier["pictures"]):
                entry.update(bytes=0, sha256="")

    on_disk(package, edit_tables(forget, TABLE), reindexed)
    assert reasons(package) == {"missing_entry"}


def test_one_broken_quality_does_not_hide_another_group(tmp_path):
    package = shutil.copytree(VALID / "two-groups-sh1", tmp_path / "package")
    for relative in ("key/T0/1.bin", "key/T0/2.bin"):
        replace_file(package, relative, b"\0" * 20)
    assert {f.where for f in validate(package)} == {"key/T0/1.bin", "key/T0/2.bin"}


def test_depths_that_disagree_with_a_level_are_counted(package):
    opened = open_package(package)
    group, coarsest = opened.manifest.groups[0], opened.manifest.qualities[-1].coarser
    sidecar = unpack_key_sidecar(opened.read("key/T0/1.bin"), group.units[0].count, group.grid, coarsest, "")
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


@pytest.mark.parametrize("table", [JSON_NAME, TABLE])
@pytest.mark.parametrize("name", ["moving", "two-groups-sh1"])
def test_random_changes_of_the_tables_never_raise(name, table, tmp_path):
    package = shutil.copytree(VALID / name, tmp_path / "package")
    chance = random.Random(name)
    before, seen = read_files(package), set()
    for _ in range(100):
        on_disk(package, lambda _: before | {table: random_tables(chance, table, before[table])}, reindexed)
        seen |= reasons(package)
    assert {"bad_value", "wrong_type", "missing_field"} <= seen

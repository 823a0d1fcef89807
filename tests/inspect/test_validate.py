"""Validation: everything wrong is a finding with its reason, nothing raises, whatever the bytes are and promise.

max_error is kept by every package, measured again against the original, and found when it is a lie.
"""

import dataclasses
import os
import re
import shutil
import struct
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest

from airgs_codec.coding.sidecar import pack_keyframe_sidecar, unpack_keyframe_sidecar
from airgs_codec.inspect import errors
from airgs_codec.media.h264 import ClosedGop, check_gop, encode_gop, keyframe_codec
from airgs_codec.media.mp4 import box, read_boxes, read_samples, read_segment, with_own_box
from tests import faces
from tests.faces import FileKind, Memory, digest, file_kind, open_package, validate
from tests.makers.refusals import TABLE, with_columns
from tests.support import mutations
from tests.support.mutations import Files, add_file, apply, honest, read_files, reindexed, set_value, write_files
from tests.support.packages import PACKAGES
from tests.support.paths import FOX, VALID
from tests.support.refusals import base_files, findings
from tests.support.scenes import moving_frames, write_sequence

MOVING = base_files("moving")
OPENED = open_package(VALID / "moving")
DELTA = "delta/L0/1.m4s"


def with_file(files: Files, relative: str, data: bytes) -> Files:
    """Write a file and make its entry agree, so that only its content can be refused."""
    return apply(files, add_file(relative, data), honest)


def test_a_folder_that_is_no_package(tmp_path):
    (tmp_path / "file").write_text("x")
    for path in (tmp_path, tmp_path / "missing", tmp_path / "file"):
        (finding,) = validate(path)
        assert finding.reason == "missing_file" and "\n" not in str(finding)


def test_every_broken_file_has_its_own_finding():
    listed = sorted(p for p in OPENED.manifest.files() if file_kind(p) is not FileKind.MANIFESTS)
    left = {name: data for name, data in MOVING.items() if name not in listed}
    assert [(f.reason, f.where) for f in findings(left)] == [("missing_file", relative) for relative in listed]
    groups, paths = base_files("two-groups-sh1"), ["keyframe/T0/1.bin", "keyframe/T0/2.bin"]
    for relative in paths:
        groups = with_file(groups, relative, b"\0" * 20)
    assert {f.where for f in findings(groups)} == set(paths)


def test_only_plain_files_belong_to_a_package(tmp_path):
    """Links are refused wherever they lead; what is neither file nor folder is foreign."""
    package = shutil.copytree(VALID / "moving", tmp_path / "package")
    media = package / "delta/L0/1.m4s"
    media.rename(tmp_path / "elsewhere.m4s")
    media.symlink_to(tmp_path / "elsewhere.m4s")
    (package / "folder").symlink_to(tmp_path)
    os.mkfifo(package / "pipe")
    found = {(f.reason, f.where) for f in validate(package)}
    assert found == {("unsafe_path", "delta/L0/1.m4s"), ("unsafe_path", "folder"), ("foreign_file", "pipe")}


def grey_media(value: int, atlas: faces.Atlas, like: bytes) -> bytes:
    """A media segment of a picture of one value, with its checksums and the columns of another segment."""
    gop, codec = ClosedGop([np.full((atlas.height, atlas.width), value, np.uint8)], 0, 1000), keyframe_codec("veryfast")
    coded = encode_gop(gop, (atlas.width, atlas.height), Fraction(24), codec)
    return with_own_box(coded.fragment, check_gop(coded, gop, codec).checksums, read_segment(like).columns or b"")


def test_fewer_pictures_than_frames_are_refused():
    data = grey_media(128, OPENED.manifest.groups[0].levels[0], MOVING[DELTA])
    package = faces.open_files(Memory("fewer", with_file(MOVING, DELTA, data)))
    with pytest.raises(faces.FormatError, match=r"delta/L0/1\.m4s: expected 4 pictures, got 0"):
        list(faces.decode_segment(package, 0, faces.decode_canonical(package, 0, 0), 0, range(4)))


def forget_keyframes(table):
    for tier in table["tiers"]:
        for entry in (tier["sidecar"], *tier["pictures"]):
            entry.update(bytes=0, sha256="")


def lower_depths(files: Files) -> Files:
    """Depths that disagree with a level, whose updates are counted."""
    group, coarsest = OPENED.manifest.groups[0], OPENED.manifest.qualities[-1].coarser
    sidecar = unpack_keyframe_sidecar(files["keyframe/T0/1.bin"], group.tiers[0].count, group.grid, coarsest, "")
    lower = dataclasses.replace(sidecar, depths=np.minimum(sidecar.depths, 0))
    return with_file(files, "keyframe/T0/1.bin", pack_keyframe_sidecar(lower, group.grid, coarsest))


def frame_bytes(more: int) -> mutations.Mutation:
    sizes = [1, 1, 1, OPENED.manifest.segments[0].levels[0].file.bytes - 3 + more]
    return set_value(("segments", 0, "levels", 0, "frame_bytes"), sizes, TABLE)


ENDLESS = [set_value(("keyframe_steps", name), 1e30, TABLE) for name in ("log_scales", "quaternions")]
ENDLESS += [set_value(("qualities", q, "factor"), 1e6) for q in (0, 1)] + [set_value(("keyframe_gain",), 1e-3)]


@pytest.mark.parametrize(("changes", "reason"), [
    *[([set_value(("qualities", 1, "coarser"), cells)], "bad_sidecar") for cells in (0, 2, 3)],  # it was 1
    *[([frame_bytes(more), reindexed], "size_mismatch") for more in (1, 10**9)],  # than the file has
    ([*ENDLESS, reindexed], "bad_value"),  # steps that decode to no finite number
    ([mutations.edit_tables(forget_keyframes, TABLE), reindexed], "missing_entry"),
    ([lower_depths], "count_mismatch"),
])  # fmt: skip
def test_tables_and_files_that_do_not_fit_each_other_are_refused(changes, reason):
    assert OPENED.manifest.qualities[1].coarser == 1
    found = findings(apply(MOVING, *changes))
    assert {f.reason for f in found} == {reason} and all("\n" not in str(f) for f in found)


def resampled(data: bytes, change: Callable[[bytes], bytes]) -> bytes:
    """A media segment whose first sample is another one, of which its boxes know."""
    own, moof, _ = (whole for _, whole in read_boxes(data))
    first, *others = read_samples(data[len(own) :])
    sizes = moof.index(b"trun") + 20
    assert struct.unpack_from(">I", moof, sizes) == (len(first),)
    moof = moof[:sizes] + struct.pack(">I", len(change(first))) + moof[sizes + 4 :]
    return own + moof + box(b"mdat", change(first), *others)


def field(name: bytes, place: int, value: bytes) -> Callable[[bytes], bytes]:
    """Other bytes in a box, so many after its name."""

    def change(data: bytes) -> bytes:
        at = data.index(name) + 4 + place
        return data[:at] + value + data[at + len(value) :]

    return change


def filler(data: bytes) -> bytes:
    unit = b"\x0c" + b"\xff" * 100_000 + b"\x80"
    return resampled(data, lambda sample: sample + struct.pack(">I", len(unit)) + unit)


def with_sps(place: int, value: int) -> Callable[[bytes], bytes]:
    return lambda data: resampled(data, lambda s: s[: 4 + place] + bytes([value]) + s[5 + place :])


HUGE = struct.pack(">Q", 10**12)


def more_pictures(data: bytes) -> bytes:
    return with_columns(MOVING[DELTA], read_segment(data).columns or b"")


def bright(data: bytes) -> bytes:
    return grey_media(240, OPENED.manifest.groups[0].tiers[0].qualities[0], data)


TONE, INIT, KEYFRAMES = "sound/1.m4a", "init.mp4", [f"keyframe/T1/Q{q}/1.m4s" for q in (0, 1)]
WRONG = {
    f"{what} of {path}": (path, change, expected)
    for paths, what, change, expected in (
        (
            (DELTA, "delta/L1/1.m4s", *KEYFRAMES),
            "columns",
            lambda data: with_columns(data, bytes(20)),
            r"\[bad_sidecar\]",
        ),
        (KEYFRAMES, "end", lambda data: data[:-30], r"\[bad_picture\]"),
        (["keyframe/T0/Q0/1.m4s"], "more pictures", more_pictures, r"\[bad_picture\]"),
        (["keyframe/T0/Q0/1.m4s"], "luma", bright, r"16 to 235.*\[bad_picture\]"),
        # What no decoder of ours needs and other players stumble over
        ((DELTA, KEYFRAMES[1]), "start", field(b"tfdt", 4, HUGE), "box tfdt, byte 12: expected 0, got 1000000000000"),
        ((DELTA, KEYFRAMES[1]), "track", field(b"tfhd", 4, b"\0\0\0\2"), "box tfhd, byte 12: expected 1, got 2"),
        ((DELTA, KEYFRAMES[1]), "filler", filler, r"got units \[7, 8, 5, 12\]"),
        ((DELTA, KEYFRAMES[1]), "level", with_sps(3, 62), "level up to 51 for .*, got 100 and 62"),
        ((DELTA, KEYFRAMES[1]), "profile", with_sps(1, 110), "got 110 and"),
        (
            (DELTA, KEYFRAMES[1]),
            "tail",
            lambda data: data[:-8] + box(b"free", bytes(8)) + data[-8:],
            r"\[bad_picture\]",
        ),
        ([TONE], "duration", field(b"tfhd", 8, b"\0\0\0\1"), "box tfhd, byte 16: expected 960, got 1"),
        ([TONE], "start", field(b"tfdt", 4, HUGE), "got .1000000000000, "),
        ([TONE], "roll", field(b"sbgp", 12, b"\0\0\0\1"), "box sbgp"),
        ([INIT], "zeros", lambda data: bytes(len(data)), r"\[bad_picture\]"),
        ([INIT], "level", field(b"avcC", 3, b"\x3e"), "box stsd"),
        ([INIT], "time", field(b"mdhd", 12, b"\0\0\0\1"), "box mdhd, byte 20: expected 30000, got 1"),
    )
    for path in paths
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_in_a_file_is_found_for_us_and_for_other_players(name):
    path, change, expected = WRONG[name]
    files = base_files("sound" if path == TONE else "moving")
    (finding,) = findings(with_file(files, path, change(files[path])))
    assert finding.where == path and re.search(expected, str(finding))


@pytest.mark.parametrize("end", [0, 2000])
def test_composition_times_and_a_poster_are_looked_at(demo_package, end):
    files = read_files(demo_package)
    poster = files["poster.jpg"][:end] or b"no picture"
    entry = {"bytes": len(poster), "sha256": digest(poster)}
    wild = mutations.rewrite(DELTA, field(b"trun", 20, b"\x3b\x9a\xca\0"))
    found = findings(apply(files, add_file("poster.jpg", poster), wild, honest, set_value(("poster",), entry)))
    assert [f.where for f in found] == [DELTA, "poster.jpg"]
    assert "box trun" in str(found[0]) and "expected a JPEG" in str(found[1])


def test_groups_that_no_page_leads_to_are_not_looked_for_and_a_session_without_them_ends(tmp_path, capsys):
    """A package of 16 million groups, of which airgs.json is all there is."""
    many, page = faces.PAGE**4, "index/4/1.json"
    index = [{"frames": [], "segments": [], "bytes": [], "sha256": ""}] * 4
    index.append({"frames": [many], "segments": [many], "bytes": [100], "sha256": "A" * 32})
    bomb = write_files(tmp_path / "bomb", apply(MOVING, set_value(("index",), index), set_value(("frames",), many)))
    assert [(f.reason, f.where) for f in validate(bomb)] == [("missing_file", page)]
    assert list(faces.find_faults(open_package(bomb))) == [page]
    assert faces.airgs_manifest(["inspect", str(bomb)]) == 2
    assert page in (said := capsys.readouterr().err) and said.count("\n") == 1
    assert faces.airgs_play([str(bomb), "--trace", "const:8", "--json"]) == 0
    assert "1000 segments in a row were lost" in capsys.readouterr().out
    assert faces.airgs_play([str(bomb), "--trace", "const:8", "--report", str(tmp_path / "report")]) == 2
    assert len(capsys.readouterr().err) < 1000


def test_text_of_a_package_does_not_act_on_a_terminal(tmp_path, capsys):
    evil = "\x1b[2J\x9b2J\u202eby a friend"
    write_files(tmp_path / "p", apply(MOVING, set_value(("attribution",), evil)))
    assert faces.airgs_manifest(["inspect", str(tmp_path / "p")]) == 0
    said = capsys.readouterr().out
    assert r"\x1b[2J\x9b2J\u202eby a friend" in said and all(c.isprintable() or c == "\n" for c in said)


def test_every_atlas_keeps_its_bound_and_the_bound_is_tight_and_wider_in_coarser_levels(demo_package):
    package = open_package(demo_package)
    m, measured = package.manifest, list(faces.measure_errors(package, faces.open_sequence(FOX)))
    assert len({e.where for e in measured}) == len(m.groups) * (m.tiers * len(m.qualities) + len(m.levels))
    assert {e.attribute for e in measured if "keyframe" in e.where} == set(faces.KEYFRAME.attributes)
    assert {e.attribute for e in measured if "delta" in e.where} == set(faces.DELTA.attributes)
    for e in measured:
        assert e.error <= e.bound, e
        assert e.ambiguous <= 0.02 * e.rows
    ratios = [e.error / e.bound for e in measured if e.bound]
    assert np.median(ratios) > 0.9 and min(ratios) > 0.5  # at most a sixth of a step is lost to not looking closer
    for group in m.groups:
        bounds = np.array([atlas.max_error for atlas in group.levels])
        assert (bounds[-1] >= bounds[0]).all() and (bounds[-1] > bounds[0]).any()


def test_a_lie_is_found_and_another_sequence_refused(demo_copy, tmp_path, capsys):
    assert faces.airgs_manifest(["validate", str(demo_copy), "--against", str(FOX)]) == 0
    assert "measured / max_error" in capsys.readouterr().out
    promised = open_package(demo_copy).manifest.groups[0].levels[0].max_error[0]
    mutations.on_disk(demo_copy, set_value(("levels", 0, "max_error", 0), 0.5 * promised, TABLE), reindexed)
    assert faces.airgs_manifest(["validate", str(demo_copy), "--against", str(FOX)]) == 1
    assert "means: max_error" in capsys.readouterr().out
    other = faces.open_sequence(write_sequence(tmp_path / "scene", moving_frames(20, 3)))
    with pytest.raises(faces.ConfigError, match="expected 10 frames"):
        list(faces.measure_errors(open_package(demo_copy), other))


def test_rows_that_are_left_out_turned_or_never_updated_keep_their_promises(package_of):
    """The rows are in another order; those that move and are never updated are found by their mean."""
    package, sequence = open_package(package_of("turned")), PACKAGES["turned"].scene()
    measured, base = list(faces.measure_errors(package, sequence)), faces.decode_canonical(package, 0, 0)
    assert validate(package.files.path) == faces.exceeded(measured) == []
    assert max(m.ambiguous for m in measured) == 0 and all(e.error <= e.bound for e in measured)
    assert package.manifest.groups[0].left_out[0].what == "gaussians" and package.manifest.sh_degree == 1
    assert (base.depths == faces.STATIC).sum() > 200  # of 305, half of which swing: most of them with no update
    assert sum(e.attribute == "quaternions" and "keyframe" in e.where and e.rows > 0 for e in measured)
    assert np.linalg.norm(faces.to_rotation_vector(base.quaternions), axis=1).max() < np.radians(70)  # 62.8, and a step


def test_the_nearest_original_that_keeps_the_promise_is_taken_or_the_nearest():
    """One row is off by a little in all, and by too much in one; the other is further away, and within the promise."""
    originals, promised, found = np.zeros((3, 19)), np.full((2, 19), 0.5), np.zeros((2, 19))
    originals[0, 0], originals[1, :], originals[2, :] = 0.6, 0.4, 9.0
    assert errors._nearest(originals, found, promised).tolist() == [1, 1]
    promised[1, 18] = 0.1
    assert errors._nearest(originals, found, promised).tolist() == [1, 0]


def test_promises_are_in_the_units_of_what_is_compared(demo_package):
    """Means of a row with twice the motion unit may err by twice as much."""
    package = open_package(demo_package)
    base, group = faces.decode_canonical(package, 0, 0), package.manifest.groups[0]
    promised = errors._promised(group, base)
    moving = base.depths != faces.STATIC
    ratio = base.motion_units / np.median(base.motion_units)
    bound = group.levels[0].max_error[0] / group.delta_steps.means
    np.testing.assert_allclose(promised[moving, 0], bound * ratio[moving], rtol=1e-6)
    assert moving.any() and len(np.unique(ratio[moving])) > 1
    near, far = (errors._features([base.to_gaussians()], group, scale)[:, :3] for scale in (1.0, 0.5))
    assert (far == 2 * near).all() and near.any()

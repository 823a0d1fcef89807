"""What `open_sequence` opens: single files, folders of any format, models with iterations."""

import numpy as np
import pytest

from tests.faces import (
    EncodeSettings,
    SceneError,
    airgs_encode,
    decode,
    encode,
    is_multiview,
    open_package,
    open_sequence,
    validate,
    write_ply,
)
from tests.support.scenes import moving_frames, random_gaussians, write_sequence
from tests.support.splat_files import SUFFIXES, splat_bytes, write_sog_folder


@pytest.mark.parametrize("names", [["time_00000", "time_00002", "time_00010"], ["frame-1", "frame-2", "frame-10"]])
@pytest.mark.parametrize("suffix", [".ply", ".splat", ".v3.spz"])
def test_a_folder_of_any_format_in_natural_order(tmp_path, names, suffix):
    for name, g in zip(names, moving_frames(20, 3), strict=True):
        path = tmp_path / f"{name}{suffix}"
        write_ply(path, g) if suffix == ".ply" else path.write_bytes(splat_bytes(g, suffix))
    sequence = open_sequence(tmp_path)
    assert [path.name for path in sequence.paths] == [f"{name}{suffix}" for name in names]
    assert len(sequence.load([0, 2]).frames[1]) == 20 and not is_multiview(tmp_path)


@pytest.mark.parametrize(
    ("names", "says"),
    [
        ("f_1 f_2 f_3", []),
        ("f_01_lod0 f_02_lod0", []),
        ("first second", []),
        (
            "frame_1 frame_3 frame_10",
            ["frame_#: 7 numbers are missing, the first between 1 and 3: frames are taken as"],
        ),
        (
            "frame_1 frame_2 take2-frame_3",
            ["frames have names of 2 kinds, frame_# (2), take2-frame_# (1): all are taken"],
        ),
        ("t1_f1 t1_f2 t2_f1", ["frames have names of 2 kinds, t1_f# (2), t2_f# (1)"]),
        ("f1 f01 f2", ["f#: some frames have the same number, such as 1"]),
        ("f1 f2 background", ["frames have names of 2 kinds, background (1), f# (2)"]),
    ],
)
def test_odd_names_are_told(tmp_path, names, says):
    for name in names.split():
        write_ply(tmp_path / f"{name}.ply", random_gaussians(9))
    notes = open_sequence(tmp_path).notes
    assert len(notes) == len(says) and all(note.startswith(words) for note, words in zip(notes, says, strict=True))


def test_a_frame_of_another_scene_is_told_before_and_in_the_package(tmp_path, capsys):
    """By its number of rows where that is another one, else by where its Gaussians lie."""
    frames = moving_frames(60, 6)
    frames[2] = random_gaussians(50)
    frames[4] = frames[4].placed(np.zeros(3), 100)
    folder = write_sequence(tmp_path / "scene", frames)
    lone, strange = "000002.ply: 50 Gaussians, frames beside it have 60", "frames 4-5: Gaussians lie elsewhere"
    options = ["--calibrate", "none", "--measure-pictures", "0", "--x264-preset", "ultrafast"]
    assert airgs_encode([str(folder), "-o", str(tmp_path / "x.airgs"), *options]) == 0
    assert lone in capsys.readouterr().err
    decisions = open_package(tmp_path / "x.airgs").manifest.decisions
    assert [sum(line.startswith(words) for line in decisions) for words in (lone, strange)] == [1, 1]


def test_folders_of_sog_are_frames_and_one_is_a_scene(tmp_path):
    for name in ("f2", "f10"):
        write_sog_folder(tmp_path / name, random_gaussians(30))
    assert [path.name for path in open_sequence(tmp_path).paths] == ["f2", "f10"]
    for place in (tmp_path / "f2", tmp_path / "f2" / "meta.json"):
        sequence = open_sequence(place)
        assert len(sequence) == 1 and len(sequence.read(0)) == 30
    assert not is_multiview(tmp_path) and not is_multiview(tmp_path / "f2")


@pytest.mark.parametrize("inner", ["", "point_cloud"])
def test_of_a_model_the_newest_iteration_is_taken(tmp_path, inner):
    for number in (7000, 30000, 900):
        folder = tmp_path / "point_cloud" / f"iteration_{number}"
        folder.mkdir(parents=True)
        write_ply(folder / "point_cloud.ply", random_gaussians(number // 100))
    (tmp_path / "input.ply").write_bytes(b"ply\n")
    assert len(open_sequence(tmp_path / inner).read(0)) == 300


def test_one_file_is_a_scene_whatever_lies_beside_it(tmp_path):
    for i, g in enumerate(moving_frames(20, 3)):
        write_ply(tmp_path / f"{i}.ply", g)
    (tmp_path / "sequence.json").write_text('{"fps": 12, "keyframes": [0, 2]}')
    sequence = open_sequence(tmp_path / "1.ply")
    assert (len(sequence), sequence.fps, sequence.keyframes) == (1, 30, None)


def test_hidden_files_are_no_frames(tmp_path):
    write_ply(tmp_path / "1.ply", random_gaussians(9))
    (tmp_path / "._1.ply").write_bytes(b"\0\5\x16\7")
    assert [path.name for path in open_sequence(tmp_path).paths] == ["1.ply"]


def test_a_folder_with_a_clip_says_how_to_give_it(tmp_path):
    (tmp_path / "spinach.splatv").write_bytes(b"")
    with pytest.raises(SceneError, match=r"spinach\.splatv by its own name"):
        open_sequence(tmp_path)


def test_no_frame_is_lost_for_its_capitals_and_equal_numbers_have_an_order(tmp_path):
    for name in ("2.ply", "1.PLY", "01.ply", "001.ply"):
        write_ply(tmp_path / name, random_gaussians(9))
    assert [path.name for path in open_sequence(tmp_path).paths] == ["001.ply", "01.ply", "1.PLY", "2.ply"]


def test_levels_of_detail_are_no_frames(tmp_path):
    """A folder that splat-transform makes of a large scene; every folder in it is a whole SOG."""
    for name in ("0_0", "1_0"):
        write_sog_folder(tmp_path / name, random_gaussians(9))
    (tmp_path / "lod-meta.json").write_text("{}")
    with pytest.raises(SceneError, match=r"expected frames, got levels of detail"):
        open_sequence(tmp_path)


def test_a_mixture_is_refused_and_ply_goes_first(tmp_path):
    for suffix in (".splat", ".v3.spz"):
        (tmp_path / f"a{suffix}").write_bytes(splat_bytes(random_gaussians(9), suffix))
    with pytest.raises(SceneError, match=r"one format, got \.splat, \.spz"):
        open_sequence(tmp_path)
    write_ply(tmp_path / "a.ply", random_gaussians(9))
    assert [path.name for path in open_sequence(tmp_path).paths] == ["a.ply"]
    (tmp_path / "a.ksplat").write_bytes(b"x")
    with pytest.raises(SceneError, match=r"a\.ksplat: expected one of \.ply, "):
        open_sequence(tmp_path / "a.ksplat")


@pytest.mark.parametrize("suffix", [".v4.spz", ".glb"])
def test_one_static_file_is_encoded_to_a_package_that_decodes(tmp_path, suffix):
    assert suffix in SUFFIXES
    (tmp_path / f"a{suffix}").write_bytes(splat_bytes(random_gaussians(300, 1), suffix))
    sequence = open_sequence(tmp_path / f"a{suffix}")
    encode(sequence, tmp_path / "a.airgs", EncodeSettings(calibrate="none", measure_pictures=2, preset="veryfast"))
    package = open_package(tmp_path / "a.airgs")
    assert (package.manifest.frames, len(package.manifest.groups)) == (1, 1)
    assert validate(tmp_path / "a.airgs") == []
    assert np.isfinite(decode(package, 0).means).all()

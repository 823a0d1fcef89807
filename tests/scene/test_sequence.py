"""What `open_sequence` opens: files, folders of any format and those that grow; what is refused and told."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from tests import faces
from tests.faces import GrowingFolder, SceneError, open_sequence, read_frame, write_ply
from tests.support.camera_files import saved
from tests.support.paths import FOX
from tests.support.scenes import moving_frames, random_gaussians, write_sequence
from tests.support.splat_files import splat_bytes, write_sog_folder


def names_of(folder):
    return [path.name for path in open_sequence(folder).paths]


def write_names(folder, names):
    folder.mkdir(exist_ok=True)
    for name in names.split():
        write_ply(folder / name, random_gaussians(9))
    return folder


@pytest.mark.parametrize("names", ["f1 f2 f10", "time_00000 time_00002 time_00010", "frame-1 frame-2 frame-10"])
@pytest.mark.parametrize("suffix", [".ply", ".splat", ".v3.spz"])
def test_a_folder_of_any_format_in_natural_order(tmp_path, names, suffix):
    for name, g in zip(names.split(), moving_frames(20, 3), strict=True):
        path = tmp_path / f"{name}{suffix}"
        write_ply(path, g) if suffix == ".ply" else path.write_bytes(splat_bytes(g, suffix))
    assert names_of(tmp_path) == [f"{name}{suffix}" for name in names.split()]
    assert len(open_sequence(tmp_path).load([0, 2]).frames[1]) == 20 and not faces.is_multiview(tmp_path)


@pytest.mark.parametrize("suffix", [".v4.spz", ".glb"])
def test_one_static_file_of_any_format_is_a_scene_without_cameras(tmp_path, suffix):
    path = saved(tmp_path / f"a{suffix}", splat_bytes(random_gaussians(30, 1), suffix))
    sequence = open_sequence(path)
    assert (len(sequence), sequence.sh_degree, sequence.cameras, sequence.alone) == (1, 1, (), True)
    np.testing.assert_array_equal(sequence.read(0).means, read_frame(path).means)


def test_the_embedded_scene_opens_with_its_cameras_and_keyframes_from_zero():
    s = open_sequence(FOX)
    assert (len(s), s.fps, s.keyframes, s.sh_degree, len(s.cameras)) == (10, Fraction(24), (0, 5), 1, 20)
    assert s.origin == (0, 0, 0) and not s.notes and replace(s, credit="by nobody").attribution == "by nobody"
    np.testing.assert_array_equal(s.read(0).means, faces.read_ply(s.paths[0]).means)


def test_settings_given_to_open_take_precedence_and_paths_may_be_words(tmp_path):
    write_sequence(tmp_path, moving_frames(4, 2), fps=12)
    assert open_sequence(str(tmp_path)).fps == 12
    given = open_sequence(tmp_path, views=str(FOX / "transforms.json"), fps=29.97)
    assert given.fps == Fraction(2997, 100) and len(given.cameras) == 20
    for fps in (0, -1, float("nan"), 1e9):
        with pytest.raises(SceneError, match="fps"):
            open_sequence(tmp_path, fps=fps)


def test_frames_are_loaded_together_without_bands_above_the_largest_degree(tmp_path):
    frames = moving_frames(6, 3, degree=2)
    means = frames[2].means.copy()
    means[4] = np.nan
    sequence = open_sequence(write_sequence(tmp_path, [*frames[:2], replace(frames[2], means=means)]))
    low, loaded = replace(sequence, max_sh_degree=1), sequence.load([0, 2])
    assert low.sh_degree == 1
    np.testing.assert_array_equal(low.read(1).sh_rest, frames[1].sh_rest[:, :3])
    assert [len(f) for f in loaded.frames] == [6, 6]
    assert [f.opacities()[4] > 0.01 for f in loaded.frames] == [frames[0].opacities()[4] > 0.01, False]
    assert "frames 0-2: 1 Gaussians that are not finite" in loaded.notes[0]


@pytest.mark.parametrize(("names", "says"), [
    ("f_1 f_2 f_3", ""), ("f_01_lod0 f_02_lod0", ""), ("first second", ""), ("t1_f1 t1_f2 t2_f1", ""),
    ("frame_1 frame_3 frame_10", "7 numbers are missing in the names of frames, the first between 1 and 3: frames"),
])  # fmt: skip
def test_missing_numbers_are_said(tmp_path, names, says):
    write_names(tmp_path, " ".join(f"{name}.ply" for name in names.split()))
    notes = open_sequence(tmp_path).notes
    assert len(notes) == (says != "") and "".join(notes).startswith(says)


def test_a_frame_of_another_scene_is_told_before_and_to_those_who_encode(tmp_path, capsys):
    frames = moving_frames(60, 6)
    frames[2] = random_gaussians(50)
    frames[4] = frames[4].placed(np.zeros(3), 100)
    folder = write_sequence(tmp_path / "scene", frames)
    strange = "frames 4-5: Gaussians lie elsewhere"
    (tmp_path / "notes.txt").write_text("of somebody")
    assert faces.airgs_encode([str(folder), "-o", str(tmp_path)]) == 2
    told = capsys.readouterr().err
    assert "rows: the first 3 frames do not share them; tracked first, which" in told
    assert "expected a new folder or an existing package, got a folder with other files" in told
    settings = faces.EncodeSettings(calibrate="none", measure_pictures=0)
    notes = faces.decide(open_sequence(folder), settings).notes
    with faces.tracked(open_sequence(folder), faces.CPU, faces.Work()) as found:
        assert found.notes[-1].startswith("not tracked: 18.2 dB is all that a frame shows of the next one")
    assert sum(line.startswith(strange) for line in notes) == 1


def test_folders_of_sog_are_frames_and_one_is_a_scene(tmp_path):
    first, second = (write_sog_folder(tmp_path / name, random_gaussians(30)) for name in ("f2", "f10"))
    assert names_of(tmp_path) == [first.name, second.name]
    for place in (first, first / "meta.json"):
        assert open_sequence(place).count(0) == len(open_sequence(place).read(0)) == 30
        assert len(open_sequence(place)) == 1
    assert not faces.is_multiview(tmp_path) and not faces.is_multiview(first)


def test_of_a_model_the_newest_iteration_is_taken(tmp_path):
    for number in (7000, 30000, 900):
        folder = tmp_path / "point_cloud" / f"iteration_{number}"
        folder.mkdir(parents=True)
        write_ply(folder / "point_cloud.ply", random_gaussians(number // 100))
    (tmp_path / "input.ply").write_bytes(b"ply\n")
    for model in (tmp_path, tmp_path / "point_cloud"):
        assert len(open_sequence(model).read(0)) == 300


def test_hidden_files_are_no_frames_and_one_file_is_a_scene_whatever_lies_beside_it(tmp_path):
    """Capitals are frames, and equal numbers have an order."""
    write_names(tmp_path, "2.ply 1.PLY 01.ply 001.ply")
    (tmp_path / "._1.ply").write_bytes(b"\0\5\x16\7")
    assert names_of(tmp_path) == ["001.ply", "01.ply", "1.PLY", "2.ply"]
    saved(tmp_path / "sequence.json", {"fps": 12, "keyframes": [0, 2]})
    sequence = open_sequence(tmp_path / "2.ply")
    assert (len(sequence), sequence.fps, sequence.keyframes) == (1, 30, None)


def written(*frames, **files):
    """Frames in .ply, and JSON by its name."""

    def write(folder):
        for name, text in files.items():
            saved(folder / f"{name}.json", text.encode())
        return write_sequence(folder, list(frames), cameras=False)

    return write


FRAMES = moving_frames(4, 2)
REFUSED = {
    "no JSON": (written(*FRAMES, sequence="{"), r"sequence\.json"),
    "no rate": (written(*FRAMES, sequence='{"fps": 0}'), "fps"),
    "a huge rate": (written(*FRAMES, sequence='{"fps": "1e30000000"}'), r"sequence\.json"),
    "no keyframe": (written(*FRAMES, sequence='{"keyframes": [99]}'), "keyframes"),
    "a list": (written(*FRAMES, sequence="[]"), r"sequence\.json"),
    "no camera": (written(*FRAMES, transforms='{"frames": [{"camera": "a"}]}'), r"transforms\.json"),
    "no folder": (lambda folder: folder / "none", "got nothing"),
    "no frame": (lambda folder: folder, "at least one"),
    "degrees": (written(random_gaussians(3), random_gaussians(3, degree=1)), "SH degree 0"),
    "no row": (written(random_gaussians(3), random_gaussians(3).take(np.arange(0))), "at least one Gaussian"),
    "a clip": (lambda folder: saved(folder / "a.splatv", b"").parent, r"a\.splatv by its own name"),
    "another format": (lambda folder: saved(folder / "a.ksplat", b"x"), r"a\.ksplat: expected one of \.ply, "),
    "levels of detail": (  # as splat-transform makes them of a large scene, in folders that are each a whole SOG
        lambda folder: saved(write_sog_folder(folder / "0_0", FRAMES[0]).parent / "lod-meta.json", {}).parent,
        "expected frames, got levels of detail",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_sequence_is_refused(tmp_path, name):
    make, says = REFUSED[name]
    with pytest.raises(SceneError, match=says):
        open_sequence(make(tmp_path))


def test_a_mixture_is_refused_and_ply_goes_first(tmp_path):
    for suffix in (".splat", ".v3.spz"):
        saved(tmp_path / f"a{suffix}", splat_bytes(random_gaussians(9), suffix))
    with pytest.raises(SceneError, match=r"one format, got \.splat, \.spz"):
        open_sequence(tmp_path)
    assert names_of(write_names(tmp_path, "a.ply")) == ["a.ply"]


def test_a_frame_of_a_growing_folder_is_taken_once_it_is_whole_and_keyframes_when_they_are_named(tmp_path):
    first, second = moving_frames(20, 2)
    folder, path = GrowingFolder(tmp_path / "scene", fps=24), tmp_path / "scene" / "frame1.ply"
    assert folder.look() is None
    path.parent.mkdir()
    write_ply(path, first)
    data = path.read_bytes()
    for size in (0, 10, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:size])
        assert folder.look() is None
    path.write_bytes(data)
    assert len(folder.look()) == 1
    write_ply(path.with_name("frame2.ply"), second)
    sequence = folder.look()
    assert [p.name for p in sequence.paths] == ["frame1.ply", "frame2.ply"] and sequence.fps == 24
    assert folder.look() is sequence and sequence.keyframes is None
    saved(path.with_name("sequence.json"), {"fps": 25, "keyframes": [0, 1]})
    assert folder.look().keyframes == (0, 1)
    folder.check_finished()


def test_a_later_frame_waits_for_the_one_before_and_none_comes_before_what_was_taken(tmp_path):
    frames, folder = moving_frames(20, 3), GrowingFolder(tmp_path)
    with pytest.raises(SceneError, match="at least one"):
        folder.check_finished()
    write_ply(tmp_path / "7.ply", frames[0])
    (tmp_path / "8.ply").write_bytes(b"ply\n")
    write_ply(tmp_path / "9.ply", frames[2])
    assert len(folder.look()) == 1
    with pytest.raises(SceneError, match=r"8\.ply"):
        folder.check_finished()
    write_ply(tmp_path / "8.ply", frames[1])
    assert len(folder.look()) == 3
    write_ply(tmp_path / "6.ply", frames[1])
    with pytest.raises(SceneError, match=r"6\.ply: expected frames to come in the order of their names"):
        folder.look()

"""Sequences on disk: what is found beside the frames, what takes precedence, what is refused."""

import json
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from tests.faces import SceneError, open_sequence, read_ply
from tests.support.paths import FOX
from tests.support.scenes import moving_frames, random_gaussians, write_sequence


def test_frames_are_in_natural_order(tmp_path):
    frames = moving_frames(10, 3)
    write_sequence(tmp_path, frames)
    for old, new in (("000000", "f1"), ("000001", "f2"), ("000002", "f10")):
        (tmp_path / f"{old}.ply").rename(tmp_path / f"{new}.ply")
    assert [p.stem for p in open_sequence(tmp_path).paths] == ["f1", "f2", "f10"]


def test_the_embedded_scene_opens_with_its_cameras_and_keyframes_from_zero():
    s = open_sequence(FOX)
    assert (len(s), s.fps, s.keyframes, s.sh_degree, len(s.cameras)) == (10, Fraction(24), (0, 5), 1, 20)
    assert s.origin == (0, 0, 0) and not s.notes
    np.testing.assert_array_equal(s.read(0).means, read_ply(s.paths[0]).means)


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ("{", "sequence.json"),
        ('{"fps": 0}', "fps"),
        ('{"fps": "1e30000000"}', "sequence.json"),
        ('{"keyframes": [99]}', "keyframes"),
        ("[]", "sequence.json"),
    ],
)
def test_bad_settings_are_refused(tmp_path, settings, says):
    write_sequence(tmp_path, moving_frames(4, 2))
    (tmp_path / "sequence.json").write_text(settings)
    with pytest.raises(SceneError, match=says):
        open_sequence(tmp_path)


def test_no_folder_no_frames_no_gaussians_and_a_changed_degree_are_refused(tmp_path):
    with pytest.raises(SceneError, match="got nothing"):
        open_sequence(tmp_path / "none")
    with pytest.raises(SceneError, match="at least one"):
        open_sequence(tmp_path)
    write_sequence(tmp_path / "a", [random_gaussians(3), random_gaussians(3, degree=1)])
    with pytest.raises(SceneError, match="SH degree 0"):
        open_sequence(tmp_path / "a")
    write_sequence(tmp_path / "b", [random_gaussians(3), random_gaussians(3).take(np.arange(0))])
    with pytest.raises(SceneError, match="at least one Gaussian"):
        open_sequence(tmp_path / "b")


def test_bad_cameras_are_refused(tmp_path):
    write_sequence(tmp_path, moving_frames(4, 2))
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": [{"camera": "a"}]}))
    with pytest.raises(SceneError, match=r"transforms\.json"):
        open_sequence(tmp_path)


def test_settings_given_to_open_take_precedence_and_paths_may_be_words(tmp_path):
    write_sequence(tmp_path / "scene", moving_frames(4, 2), fps=12)
    assert open_sequence(str(tmp_path / "scene")).fps == 12
    given = open_sequence(tmp_path / "scene", views=str(FOX / "transforms.json"), fps=29.97)
    assert given.fps == Fraction(2997, 100) and len(given.cameras) == 20
    for fps in (0, -1, float("nan"), 1e9):
        with pytest.raises(SceneError, match="fps"):
            open_sequence(tmp_path / "scene", fps=fps)


def test_bands_above_the_largest_degree_are_not_read(tmp_path):
    frames = moving_frames(4, 2, degree=2)
    sequence = replace(open_sequence(write_sequence(tmp_path, frames)), max_sh_degree=1)
    assert sequence.sh_degree == 1
    np.testing.assert_array_equal(sequence.read(1).sh_rest, frames[1].sh_rest[:, :3])


def test_frames_are_loaded_together(tmp_path):
    frames = moving_frames(6, 3)
    means = frames[2].means.copy()
    means[4] = np.nan
    sequence = open_sequence(write_sequence(tmp_path, [*frames[:2], replace(frames[2], means=means)]))
    assert [len(f) for f in sequence.load([0, 2]).frames] == [6, 6]
    assert [f.opacities()[4] > 0.01 for f in sequence.load([0, 2]).frames] == [frames[0].opacities()[4] > 0.01, False]
    assert "frames 0-2: 1 Gaussians that are not finite" in sequence.load([0, 2]).notes[0]

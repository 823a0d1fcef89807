import json
from fractions import Fraction

import numpy as np
import pytest

from airgs_codec.analysis.grouping import plan_groups
from airgs_codec.errors import SceneError
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import open_sequence, repair
from tests.support.paths import FOX
from tests.support.scenes import moving_frames, random_gaussians, write_sequence


def changed(g: Gaussians, **columns) -> Gaussians:
    return Gaussians(**{n: columns.get(n, getattr(g, n)) for n in g.__slots__})


def test_frames_are_in_natural_order(tmp_path):
    frames = moving_frames(10, 3)
    write_sequence(tmp_path, frames)
    for old, new in (("000000", "f1"), ("000001", "f2"), ("000002", "f10")):
        (tmp_path / f"{old}.ply").rename(tmp_path / f"{new}.ply")
    assert [p.stem for p in open_sequence(tmp_path).paths] == ["f1", "f2", "f10"]


def test_the_embedded_scene_opens_with_its_cameras_and_keyframes():
    s = open_sequence(FOX)
    assert (len(s), s.fps, s.keyframes, s.sh_degree, len(s.cameras)) == (10, Fraction(24), (0, 5), 1, 20)
    assert plan_groups(s).spans == [(0, 5), (5, 10)]


@pytest.mark.parametrize(
    ("settings", "says"),
    [("{", "sequence.json"), ('{"fps": 0}', "fps"), ('{"keyframes": [99]}', "keyframes"), ("[]", "sequence.json")],
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


def test_groups_start_where_the_count_changes_and_after_thirty_frames(tmp_path):
    frames = moving_frames(9, 33) + moving_frames(12, 4)
    assert plan_groups(open_sequence(write_sequence(tmp_path, frames))).spans == [(0, 30), (30, 33), (33, 37)]


def test_a_count_that_changes_inside_a_given_group_is_noted(tmp_path):
    frames = moving_frames(9, 2) + moving_frames(12, 2)
    grouping = plan_groups(open_sequence(write_sequence(tmp_path, frames, keyframes=[0])))
    assert grouping.spans == [(0, 2), (2, 4)]
    assert "frame 2" in grouping.notes[0]


def test_untracked_rows_are_coded_all_intra_and_tracked_ones_are_not(tmp_path):
    shuffled = [moving_frames(200, 3)[t].take(np.random.default_rng(t).permutation(200)) for t in range(3)]
    grouping = plan_groups(open_sequence(write_sequence(tmp_path / "a", shuffled)))
    assert grouping.spans == [(0, 1), (1, 2), (2, 3)]
    assert "untracked" in grouping.notes[0]
    assert plan_groups(open_sequence(write_sequence(tmp_path / "b", moving_frames(200, 3)))).spans == [(0, 3)]


def test_repairs_are_made_in_every_frame_and_named():
    a, b = moving_frames(6, 2)
    means = b.means.copy()
    means[4, 1] = np.nan
    quaternions = a.quaternions.copy()
    quaternions[2] = 0
    logits = a.opacity_logits.copy()
    logits[0], logits[1] = np.inf, -np.inf
    done = repair([changed(a, quaternions=quaternions, opacity_logits=logits), changed(b, means=means)], "scene")
    assert [len(f) for f in done.frames] == [5, 5]
    assert done.frames[0].quaternions[2].tolist() == [1, 0, 0, 0]
    assert done.frames[0].opacity_logits[:2].tolist() == [20, -20]
    np.testing.assert_allclose(np.linalg.norm(done.frames[1].quaternions, axis=1), 1, atol=1e-6)
    assert ["dropped" in n for n in done.notes] == [True, False] and "1 Gaussians with zero" in done.notes[1]


def test_a_scene_without_a_finite_row_is_refused():
    g = random_gaussians(3)
    with pytest.raises(SceneError, match="all 3"):
        repair([changed(g, means=np.full((3, 3), np.inf, np.float32))], "scene")

"""Repairs are made in every frame of a group and named."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.errors import SceneError
from airgs_codec.scene.frames import repair
from tests.support.scenes import moving_frames, random_gaussians


def test_repairs_are_made_in_every_frame_and_named():
    a, b = moving_frames(6, 2)
    means = b.means.copy()
    means[4, 1] = np.nan
    quaternions = a.quaternions.copy()
    quaternions[2] = 0
    logits = a.opacity_logits.copy()
    logits[0], logits[1] = np.inf, -np.inf
    done = repair([replace(a, quaternions=quaternions, opacity_logits=logits), replace(b, means=means)], "scene")
    assert [len(f) for f in done.frames] == [5, 5]
    assert done.frames[0].quaternions[2].tolist() == [1, 0, 0, 0]
    assert done.frames[0].opacity_logits[:2].tolist() == [20, -20]
    np.testing.assert_allclose(np.linalg.norm(done.frames[1].quaternions, axis=1), 1, atol=1e-6)
    assert ["dropped" in n for n in done.notes] == [True, False] and "1 Gaussians with zero" in done.notes[1]


def test_a_scene_without_a_finite_row_is_refused():
    g = random_gaussians(3)
    with pytest.raises(SceneError, match="all 3"):
        repair([replace(g, means=np.full((3, 3), np.inf, np.float32))], "scene")

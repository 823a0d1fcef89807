"""Repairs are made in every frame of a group and named."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.scene.frames import Repaired, turn_least
from tests.faces import (
    Gaussians,
    SceneError,
    conjugate,
    from_rotation_vector,
    multiply,
    repair,
    to_matrices,
    to_rotation_vector,
)
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
    assert [len(f) for f in done.frames] == [6, 6] and [f.opacity_logits[4] for f in done.frames] == [
        a.opacity_logits[4],
        -20,
    ]
    np.testing.assert_array_equal(done.frames[1].means[4], a.means[4])
    assert done.frames[0].quaternions[2].tolist() == [1, 0, 0, 0]
    assert done.frames[0].opacity_logits[:2].tolist() == [20, -20]
    np.testing.assert_allclose(np.linalg.norm(done.frames[1].quaternions, axis=1), 1, atol=1e-6)
    assert ["not shown" in n for n in done.notes] == [True, False] and "1 Gaussians with zero" in done.notes[1]


def test_a_scene_without_a_finite_row_is_refused():
    g = random_gaussians(3)
    with pytest.raises(SceneError, match="100% of what is opaque in frame 0"):
        repair([replace(g, means=np.full((3, 3), np.inf, np.float32))], "scene")


def _covariances(g: Gaussians) -> np.ndarray:
    axes = to_matrices(g.quaternions) * np.exp(g.log_scales.astype(np.float64))[:, None]
    return axes @ axes.transpose(0, 2, 1)


def test_rows_that_lie_anyhow_are_turned_least_and_show_the_same():
    """All frames of a row get the same names: what it turns by from frame to frame stays, in the axes of the world."""
    still = repair([random_gaussians(500)], "scene").frames[0]
    spin = from_rotation_vector(np.tile([0.0, 0.0, 1.4], (500, 1)))  # more than any naming of axes takes away
    frames = [still, replace(still, quaternions=multiply(spin, still.quaternions).astype(np.float32))]
    turned = turn_least(Repaired(frames, [])).frames
    for before, after in zip(frames, turned, strict=True):
        np.testing.assert_allclose(_covariances(after), _covariances(before), rtol=1e-4, atol=1e-6)
        assert np.array_equal(after.means, before.means) and np.array_equal(after.opacity_logits, before.opacity_logits)
    angles = np.linalg.norm(to_rotation_vector(turned[1].quaternions.astype(np.float64)), axis=1)
    assert angles.max() < np.radians(62.8)  # no rotation is farther from all of the 24 that bring a cube to itself
    between = np.abs(np.einsum("ni,ni->n", multiply(turned[1].quaternions, conjugate(turned[0].quaternions)), spin))
    np.testing.assert_allclose(between, 1, atol=1e-5)


def test_names_of_axes_that_mean_something_stay():
    """Rows with a thin first axis and any heading: turned least, half of them would have their second one thin."""
    g = random_gaussians(500)
    heading = np.random.default_rng(1).uniform(-2.5, 2.5, 500)
    upright = from_rotation_vector(np.stack([0 * heading, 0 * heading, heading], axis=1)).astype(np.float32)
    thin = g.log_scales - np.array([3, 0, 0], np.float32)
    named = Repaired([replace(g, quaternions=upright, log_scales=thin)], [])
    assert turn_least(named) is named
    alike = Repaired([replace(g, quaternions=upright)], [])
    assert turn_least(alike) is not alike

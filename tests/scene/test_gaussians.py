"""Rows of Gaussians: rotations and codes invert one another, repairs are named, axes are turned least."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from scipy.spatial.transform import Rotation

from airgs_codec.scene.columns import SHARED, Columns
from tests import faces
from tests.support.scenes import moving_frames, random_gaussians

unit = npst.arrays(np.float64, (20, 4), elements=st.floats(-1, 1)).filter(lambda q: (q * q).sum(1).min() > 1e-6)


def test_columns_of_columns_and_lists_of_them_are_taken_and_joined_and_what_is_shared_stays():
    @dataclass(frozen=True, slots=True, eq=False)
    class Several(Columns):
        index: np.ndarray
        frames: list[faces.Gaussians]
        ratio: float = field(metadata=SHARED)

    whole = Several(np.arange(6), moving_frames(6, 2), 0.5)
    again = Several.join([whole.take(slice(0, 4)), whole.take(slice(4, 6))])
    assert (len(again), again.ratio, again.index.tolist()) == (6, 0.5, [0, 1, 2, 3, 4, 5])
    assert all((a.means == b.means).all() for a, b in zip(whole.frames, again.frames, strict=True))


@given(unit, unit)
def test_rotation_vectors_invert_up_to_sign(a, b):
    a, b = (q / np.linalg.norm(q, axis=1, keepdims=True) for q in (a, b))
    relative = faces.to_rotation_vector(faces.multiply(a, faces.conjugate(b)))
    back = faces.multiply(faces.from_rotation_vector(relative), b)
    np.testing.assert_allclose(np.abs((back * a).sum(axis=1)), 1, atol=1e-7)
    assert np.linalg.norm(relative, axis=1).max() <= np.pi + 1e-9


def test_rotation_vectors_at_the_extremes_and_matrices_of_scipy():
    v = faces.to_rotation_vector(np.array([[1, 0, 0, 0], [-1, 0, 0, 0], [0, 1, 0, 0], [1, 1e-12, 0, 0]]))
    np.testing.assert_allclose(v, [[0, 0, 0], [0, 0, 0], [np.pi, 0, 0], [2e-12, 0, 0]], atol=1e-15)
    q = np.random.default_rng(0).normal(size=(20, 4))
    np.testing.assert_allclose(faces.to_matrices(q), Rotation.from_quat(q, scalar_first=True).as_matrix(), atol=1e-12)


def test_repairs_are_made_in_every_frame_and_named():
    a, b = (replace(g, **{name: getattr(g, name).copy() for name in g.__slots__}) for g in moving_frames(6, 2, 1))
    b.sh_rest[4], b.means[4, 1], a.quaternions[2], a.opacity_logits[:2] = 9, np.nan, 0, (np.inf, -np.inf)
    done = faces.repair([a, b], "scene")
    assert [len(f) for f in done.frames] == [6, 6]
    assert [f.opacity_logits[4] for f in done.frames] == [a.opacity_logits[4], -20]
    for name in ("means", "sh_rest"):  # of the frame in which they are
        np.testing.assert_array_equal(getattr(done.frames[1], name)[4], getattr(a, name)[4])
    assert done.frames[0].quaternions[2].tolist() == [1, 0, 0, 0]
    assert done.frames[0].opacity_logits[:2].tolist() == [20, -20]
    np.testing.assert_allclose(np.linalg.norm(done.frames[1].quaternions, axis=1), 1, atol=1e-6)
    assert ["not shown" in n for n in done.notes] == [True, False] and "1 Gaussians with zero" in done.notes[1]
    with pytest.raises(faces.SceneError, match="100% of what is opaque in frame 0"):
        faces.repair([replace(a, means=np.full((6, 3), np.inf, np.float32))], "scene")


def _covariances(g):
    axes = faces.to_matrices(g.quaternions) * np.exp(g.log_scales.astype(np.float64))[:, None]
    return axes @ axes.transpose(0, 2, 1)


def test_rows_that_lie_anyhow_are_turned_least_and_show_the_same():
    """All frames of a row get the same names: what it turns by from frame to frame stays, in the axes of the world."""
    still = faces.repair([random_gaussians(500)], "scene").frames[0]
    spin = faces.from_rotation_vector(np.tile([0.0, 0.0, 1.4], (500, 1)))  # more than any naming of axes takes away
    frames = [still, replace(still, quaternions=faces.multiply(spin, still.quaternions).astype(np.float32))]
    turned = faces.turn_least(faces.Repaired(frames, [])).frames
    for before, after in zip(frames, turned, strict=True):
        np.testing.assert_allclose(_covariances(after), _covariances(before), rtol=1e-4, atol=1e-6)
        assert np.array_equal(after.means, before.means) and np.array_equal(after.opacity_logits, before.opacity_logits)
    first, second = (g.quaternions.astype(np.float64) for g in turned)
    # no rotation is farther from all of the 24 that bring a cube to itself
    assert np.linalg.norm(faces.to_rotation_vector(second), axis=1).max() < np.radians(62.8)
    between = np.abs((faces.multiply(second, faces.conjugate(first)) * spin).sum(axis=1))
    np.testing.assert_allclose(between, 1, atol=1e-5)


def test_names_of_axes_that_mean_something_stay():
    """Rows with a thin first axis and any heading: turned least, half of them would have their second one thin."""
    g, heading = random_gaussians(500), np.random.default_rng(1).uniform(-2.5, 2.5, (500, 1)) * [0, 0, 1]
    upright = replace(g, quaternions=faces.from_rotation_vector(heading).astype(np.float32))
    named = faces.Repaired([replace(upright, log_scales=g.log_scales - np.array([3, 0, 0], np.float32))], [])
    assert faces.turn_least(named) is named
    alike = faces.Repaired([upright], [])
    assert faces.turn_least(alike) is not alike

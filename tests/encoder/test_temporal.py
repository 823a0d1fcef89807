"""The scene whose Gaussians come and go has what it is for."""

import numpy as np

from tests.support.temporal import FLASHES, temporal_cameras, temporal_frames


def test_large_gaussians_pass_between_the_frames_that_are_picked_first():
    frames = temporal_frames()
    opacities = np.stack([g.opacities()[-FLASHES:] for g in frames])
    assert set((opacities > 0.1).sum(axis=0)) <= {3, 4}
    assert (opacities[[0, len(frames) // 2, -1]] < 0.45).all() and (opacities.max(axis=0) > 0.6).all()
    means = frames[0].means[-FLASHES:]
    assert all(np.linalg.norm(camera.position) > np.linalg.norm(means, axis=1).max() for camera in temporal_cameras())

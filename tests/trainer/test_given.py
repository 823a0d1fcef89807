"""Noise of what is given is spread over all that is seen; motion that was lost is in few places."""

from types import SimpleNamespace

import numpy as np
import pytest

from airgs_codec.render.backend import CPU
from airgs_codec.trainer.frames import is_known
from tests.support.views import coloured_cloud, ring


@pytest.mark.parametrize(("spread", "noise"), [(True, True), (False, False)], ids=["everywhere", "in a corner"])
def test_noise_is_spread_and_lost_motion_is_not(spread, noise):
    g, rng = coloured_cloud(), np.random.default_rng(0)
    views = []
    for camera in ring(3):
        drawn = CPU.load(g).draw(camera).rgb
        error = 0.05 * rng.normal(size=drawn.shape)
        if not spread:
            error[drawn.shape[0] // 2 :] *= 1e-3
            error[:, drawn.shape[1] // 4 :] *= 1e-3
        target = (drawn + error * (np.abs(drawn) > 0.01)).astype(np.float32)
        views.append(SimpleNamespace(camera=camera, target=SimpleNamespace(rgb=target)))
    assert is_known(SimpleNamespace(renderer=CPU), g, views) == noise

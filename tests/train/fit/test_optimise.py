"""The loop: losses that are not finite, and rows at the ends of float32."""

import math

import numpy as np
import pytest

from airgs_codec.errors import TrainingError
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.train.fit.optimise import Schedule, optimise
from airgs_codec.train.fit.parameters import from_gaussians, to_gaussians
from airgs_codec.train.fit.per_gaussian import PerGaussian
from tests.support.views import coloured_cloud, ring, views_of


def test_a_loss_that_is_not_finite_ends_the_fit_with_the_view():
    g = coloured_cloud(20)
    views = views_of(g, ring(2))
    views[0].target.rgb[:] = views[1].target.rgb[:] = np.nan
    variables = PerGaussian(from_gaussians(g), 5.0)
    with pytest.raises(TrainingError, match="iteration 1 in view cam0"):
        optimise(variables, views, Schedule("fit", 5, lambda done: 0), np.random.default_rng(0))


@pytest.mark.parametrize("extreme", ["opaque", "tiny", "huge", "zero quaternion"])
def test_extreme_rows_stay_finite_in_a_fit(extreme):
    g = coloured_cloud(40)
    columns = {n: getattr(g, n).copy() for n in g.__slots__}
    if extreme == "opaque":
        columns["opacity_logits"][:10] = [100, -100, 20, -20, 0, 50, -50, 5, -5, 1]
    elif extreme == "tiny":
        columns["log_scales"][:10] = -30
    elif extreme == "huge":
        columns["log_scales"][:5] = 8
    else:
        columns["quaternions"][:10] = 0
    views = views_of(g, ring(4))
    variables = PerGaussian(from_gaussians(Gaussians(**columns)), 5.0)
    optimise(variables, views, Schedule("fit", 30, lambda done: 0), np.random.default_rng(0))
    after = to_gaussians(variables.detached())
    assert all(np.isfinite(getattr(after, n)).all() for n in g.__slots__)
    assert after.log_scales.max() <= math.log(5.0) + 1e-5


def test_progress_counts_every_iteration():
    said = []
    g = coloured_cloud(20)
    schedule = Schedule("fit", 3, lambda done: 0)
    variables, rng = PerGaussian(from_gaussians(g), 5.0), np.random.default_rng(0)
    optimise(variables, views_of(g, ring(2)), schedule, rng, progress=lambda *what: said.append(what))
    assert said == [("fit", 1, 3), ("fit", 2, 3), ("fit", 3, 3)]

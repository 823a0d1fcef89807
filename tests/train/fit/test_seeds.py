"""Seeds in what appeared."""

import numpy as np

from airgs_codec.train.fit.seeds import find_wrong, residual_seeds
from tests.support.views import BALL, appeared, coloured_cloud, joined, ring, views_of


def test_seeds_lie_in_what_appeared():
    old = coloured_cloud()
    views = views_of(joined(old, appeared()), ring(8))
    seeds = residual_seeds(old, views, find_wrong(old, views), 120, 1.0, np.random.default_rng(0))
    assert 0 < len(seeds) <= 120
    # The ball can be seen to 0.45 from its centre (0.24 + 3 sigma of 0.07), and a pixel is 0.1 wide there.
    assert np.linalg.norm(seeds.means - BALL, axis=1).max() < 0.6
    same = views_of(old, ring(8))
    assert residual_seeds(old, same, find_wrong(old, same), 120, 1.0, np.random.default_rng(0)) is None

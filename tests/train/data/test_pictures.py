"""Pictures at training size: rays, memory, exposure."""

import numpy as np
import pytest

from airgs_codec.train.data.pictures import Pictures
from airgs_codec.train.data.readers import open_scene


def test_smaller_pictures_keep_their_rays(moving):
    scene = open_scene(moving)
    small, full = Pictures(scene, max_size=24).cameras()[0], scene.cameras[0]
    assert (small.width, small.height) == (24, 24)
    assert (small.cx / small.fx, small.width / small.fx) == pytest.approx((full.cx / full.fx, full.width / full.fx))
    assert Pictures(scene, max_size=24).train(0)[0].target.rgb.shape == (24, 24, 3)


def test_the_cache_is_bounded(moving):
    scene = open_scene(moving)
    pictures = Pictures(scene, cache_bytes=3 * 3 * 48 * 48 * 3 * 4)
    pictures.train(0)
    pictures.train(1)
    assert len(pictures._kept) <= 3


def test_pictures_are_exposed_alike(moving):
    pictures = Pictures(open_scene(moving))
    before = pictures.train(0)[0].target.rgb
    pictures = pictures.with_exposure({"cam00": [2.0, 2.0, 2.0, 0.1, 0.1, 0.1]})
    np.testing.assert_allclose(pictures.train(0)[0].target.rgb, (before - 0.1) / 2, atol=1e-6)
    assert (pictures.train(0)[1].target.rgb == Pictures(open_scene(moving)).train(0)[1].target.rgb).all()

"""Pictures at training size: rays, memory, exposure."""

import numpy as np
import pytest

from airgs_codec.errors import SceneError
from airgs_codec.train.data.pictures import Pictures
from airgs_codec.train.data.readers import open_scene
from tests.support.multiview_files import write_panoptic, write_rgba, write_views
from tests.support.views import coloured_cloud, ring


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


def write_cut_out(folder):
    """One picture of a red square whose left half is transparent."""
    write_views(folder, [coloured_cloud(30)], ring(2), None)
    for c in ring(2):
        picture = np.full((48, 48, 4), 255, np.uint8)
        picture[..., 1:3], picture[:, :24, 3] = 0, 0
        write_rgba(folder / "images" / c.name / "0000.png", picture)
    return open_scene(folder)


@pytest.mark.parametrize(
    ("background", "left"), [(None, (0, 0, 0)), ("white", (1, 1, 1)), ("0.5,0,1", (0.5, 0, 1)), ("random", (0, 0, 0))]
)
def test_what_is_transparent_shows_the_background(tmp_path, background, left):
    view = Pictures(write_cut_out(tmp_path), background=background).train(0)[0]
    assert view.camera.background == left
    assert np.allclose(view.target.rgb[:, :24], left) and np.allclose(view.target.rgb[:, 24:], (1, 0, 0))
    moved = view.before((0.2, 0.4, 0.6))
    assert moved.camera.background == (0.2, 0.4, 0.6)
    assert np.allclose(moved.target.rgb[:, :24], (0.2, 0.4, 0.6)) and np.allclose(moved.target.rgb[:, 24:], (1, 0, 0))
    arrays = [part for part in vars(view.target).values() if part.base is None]
    assert view.target.nbytes == sum(part.nbytes for part in arrays)


def test_masks_leave_the_background_and_opaque_pictures_have_no_random_one(tmp_path):
    scene = open_scene(write_panoptic(tmp_path, ring(2)))
    cut = Pictures(scene, foreground=True, background="white").train(0)[0].target.rgb
    assert cut[:, :24].min() == 1 and 0.7 < cut[:, 24:].min() < 0.9
    Pictures(scene, foreground=True, background="random").train(0)[0].before((0, 1, 0))
    with pytest.raises(SceneError, match="expected alpha for random backgrounds, got an opaque picture"):
        Pictures(scene, background="random").train(0)

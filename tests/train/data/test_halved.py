"""Views at half their size show the same scene, and the same part of it is drawn again."""

import numpy as np
import pytest

from airgs_codec.render import cpu, look_at
from airgs_codec.render.cpu import Redraw
from airgs_codec.scene.camera import with_pixels
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.train.data.halved import can_be_halved, halve
from airgs_codec.train.data.pictures import View
from airgs_codec.train.loss.target import Target

CAMERA = look_at(np.array([0.3, 0.2, -4.0]), np.zeros(3), np.array([0.0, 1.0, 0.0]), size=75, fov_y=0.9, name="odd")


@pytest.fixture
def scene() -> Gaussians:
    rng = np.random.default_rng(3)
    n = 60
    return Gaussians(
        means=rng.uniform(-1, 1, (n, 3)).astype(np.float32),
        quaternions=np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        log_scales=np.full((n, 3), np.log(0.25), np.float32),
        opacity_logits=np.full(n, 1.0, np.float32),
        sh_dc=rng.normal(0, 1, (n, 3)).astype(np.float32),
        sh_rest=np.zeros((n, 0, 3), np.float32),
    )


def test_a_halved_camera_sees_what_its_halved_picture_shows(scene: Gaussians) -> None:
    seen = cpu.render(scene, CAMERA).rgb
    half = halve(View(CAMERA, Target(seen, np.zeros(seen.shape[:2], np.float32))))
    assert half.target.rgb.shape == (38, 38, 3)
    assert half.target.clear is not None and half.target.clear.shape == (38, 38)
    drawn = cpu.render(scene, half.camera).rgb
    error, beside = (np.abs(picture - half.target.rgb).mean() for picture in (drawn, np.roll(drawn, 1, axis=1)))
    assert error < 0.2 * beside


def test_pictures_that_are_small_on_either_side_are_not_halved() -> None:
    views = [
        View(with_pixels(CAMERA, *size), Target(np.zeros((1, 1, 3), np.float32))) for size in ((160, 200), (159, 400))
    ]
    assert can_be_halved(views[:1]) and not can_be_halved(views)


def test_tiles_are_drawn_again_where_one_of_four_was(scene: Gaussians) -> None:
    whole = cpu.render(scene, CAMERA)
    tiles = np.zeros((5, 5), np.bool_)
    tiles[1, 4] = tiles[4, 0] = True
    redraw = Redraw(tiles, lambda: whole, np.ones(len(scene.means), np.bool_))
    half = halve(View(CAMERA, Target(whole.rgb), redraw)).redraw
    assert half is not None
    assert np.argwhere(half.tiles).tolist() == [[0, 2], [2, 0]]
    assert half.rest().rgb.shape == (38, 38, 3) and half.rest().transmittance.shape == (38, 38)

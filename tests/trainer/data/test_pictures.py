"""Pictures at training size: rays, memory, exposure."""

from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from airgs_codec.media.image import resize
from airgs_codec.trainer.data.pictures import PICTURE_BYTES, TARGET_BYTES
from airgs_codec.trainer.fit.losses import moments
from tests.faces import MultiviewScene, Pictures, SceneError, Shot, open_scene
from tests.support.multiview_files import write_panoptic, write_rgba, write_views
from tests.support.views import coloured_cloud, ring


def test_smaller_pictures_keep_their_rays(moving):
    scene = open_scene(moving)
    small, full = Pictures(scene, max_size=24).cameras()[0], scene.cameras[0]
    assert (small.width, small.height) == (24, 24)
    assert (small.cx / small.fx, small.width / small.fx) == pytest.approx((full.cx / full.fx, full.width / full.fx))
    assert Pictures(scene, max_size=24).train(0)[0].target.rgb.shape == (24, 24, 3)


@dataclass
class Counted:
    """A place whose pictures are noise of one seed each, and how often they were read."""

    seed: int
    size: tuple[int, int]
    reads: list[int]

    def read(self, size):
        assert size == self.size
        self.reads.append(self.seed)
        return np.random.default_rng(self.seed).integers(0, 256, (self.size[1], self.size[0], 3), np.uint8)

    def __str__(self):
        return f"noise {self.seed}"


def noise(cameras, size):
    """A frame of many cameras, and the seeds that were read so far."""
    reads: list[int] = []
    shots = []
    for i, camera in enumerate(ring(cameras, size=16)):
        shots.append(Shot(replace(camera, width=size[0], height=size[1]), Counted(i, size, reads)))
    return MultiviewScene(Path("noise"), Fraction(30), (tuple(shots),)), reads


def test_eighty_cameras_are_never_all_in_memory():
    """A tenth of 4K each way, and a hundredth of the memory."""
    whole = 80 * 3840 * 2160 * 3
    assert whole > 1.8 * PICTURE_BYTES and 12 * whole > 11 * TARGET_BYTES
    scene, reads = noise(80, (384, 216))
    pictures = Pictures(scene, picture_bytes=PICTURE_BYTES // 100, target_bytes=TARGET_BYTES // 100)
    most = 0
    for view in pictures.train(0) + pictures.train(0)[::-1]:
        assert moments(view.target)[0].shape == (216, 3 * 384)
        most = max(most, pictures.nbytes)
    assert 0.9 * (PICTURE_BYTES + TARGET_BYTES) < 100 * most <= PICTURE_BYTES + TARGET_BYTES
    assert 80 < len(reads) < 160  # those that were seen last were at hand on the way back


def test_pictures_that_fit_are_read_once():
    scene, reads = noise(5, (30, 20))
    pictures = Pictures(scene)
    pictures.check()
    assert reads == [0, 1, 2, 3, 4]
    for view in pictures.train(0) + pictures.with_exposure({"cam00": [2.0] * 3 + [0.1] * 3}).train(0):
        assert view.target.rgb.shape == (20, 30, 3)
    assert reads == [0, 1, 2, 3, 4]
    assert pictures.nbytes == 5 * 20 * 30 * (3 + 36)


def test_opaque_pictures_at_full_size_are_exact_and_others_within_half_a_level(moving):
    scene, _ = noise(1, (30, 20))
    view = Pictures(scene).train(0)[0]
    assert (view.target.rgb == scene.frames[0][0].source.read((30, 20)).astype(np.float32) / np.float32(255)).all()
    small = Pictures(open_scene(moving), max_size=24).train(0)[0].target.rgb
    whole = Pictures(open_scene(moving)).train(0)[0].target.rgb
    assert 0 < np.abs(small - resize(whole, 24, 24)).max() <= 0.5 / 255 + 1e-6


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
    assert np.allclose(view.target.rgb[:, :24], left, atol=2e-3) and np.allclose(view.target.rgb[:, 24:], (1, 0, 0))
    moved = view.before((0.2, 0.4, 0.6))
    assert moved.camera.background == (0.2, 0.4, 0.6)
    assert np.allclose(moved.target.rgb[:, :24], (0.2, 0.4, 0.6), atol=3e-3) and np.allclose(
        moved.target.rgb[:, 24:], (1, 0, 0)
    )
    target = view.target
    assert target.nbytes == target.rgb.nbytes + target.clear.nbytes + sum(part.nbytes for part in moments(target))


def test_masks_leave_the_background_and_opaque_pictures_have_no_random_one(tmp_path):
    scene = open_scene(write_panoptic(tmp_path, ring(2)))
    cut = Pictures(scene, foreground=True, background="white").train(0)[0].target.rgb
    assert cut[:, :24].min() == 1 and 0.7 < cut[:, 24:].min() < 0.9
    Pictures(scene, foreground=True, background="random").train(0)[0].before((0, 1, 0))
    with pytest.raises(SceneError, match="expected alpha for random backgrounds, got an opaque picture"):
        Pictures(scene, background="random").check()

"""What changes nothing of a scene changes nothing of its package: its unit, and a row that is far from all else."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec import encode, open_package, open_sequence
from airgs_codec.encoder.settings import EncodeSettings, as_preview
from airgs_codec.package.manifest import pooled_quality
from airgs_codec.scene.camera import orbit_views
from airgs_codec.scene.gaussians import join_rows
from tests.support.camera_files import FORMS
from tests.support.scenes import moving_frames, write_sequence

SETTINGS = replace(as_preview(EncodeSettings()), threads=1)
FRAMES = moving_frames(200, 2)


def figures(folder, frames, scale=1.0, form="nerfstudio"):
    """Rows, bytes of the top rung, and dB of both, of a scene in units of 1 / scale."""
    rig = orbit_views(FRAMES[0], count=3, size=48)
    for camera in rig:
        camera.world_to_camera[:3, 3] *= scale
    write_sequence(folder / "scene", [g.placed(np.zeros(3), scale) for g in frames], cameras=False)
    if form:
        FORMS[form](folder / "scene", rig)
    encode(open_sequence(folder / "scene"), folder / "package", SETTINGS)
    m = open_package(folder / "package").manifest
    quality = [pooled_quality(m, level, level).psnr for level in (0, 1)]
    return m.groups[0].count, m.bytes_of(m.rung_files(0, 0)), quality


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return figures(tmp_path_factory.mktemp("plain"), FRAMES)


@pytest.mark.parametrize("form", ["nerfstudio", "colmap text", "inria"])
@pytest.mark.parametrize("scale", [1e-4, 13, 1e4])
def test_the_unit_of_a_scene_decides_nothing(plain, tmp_path, scale, form):
    rows, size, quality = figures(tmp_path, FRAMES, scale, form)
    assert rows == plain[0] and size == pytest.approx(plain[1], rel=0.02)
    assert quality == pytest.approx(plain[2], abs=0.03)  # twice what tables round


@pytest.mark.parametrize("far", [1e4, 1e6, 1e9])
@pytest.mark.parametrize("speed", [0, 1])
def test_a_row_far_away_decides_nothing_for_others(plain, tmp_path, far, speed):
    one = FRAMES[0].take([0])
    at = [np.array([[far * (1 + speed * t), 0, 0]], np.float32) for t in range(len(FRAMES))]
    frames = [join_rows([g, replace(one, means=place)]) for g, place in zip(FRAMES, at, strict=True)]
    _, size, quality = figures(tmp_path, frames)
    assert size == pytest.approx(plain[1], rel=0.05)  # it is one in two hundred
    assert quality == pytest.approx(plain[2], abs=0.2)

"""Reconstructions as COLMAP itself reads and writes them."""

import cv2
import numpy as np
import pycolmap
import pytest

from airgs_codec.media.image import TO_CENTRES
from airgs_codec.scene.cameras import colmap
from tests.support.camera_files import write_colmap_binary, write_colmap_text
from tests.support.views import ring

POINTS = np.array([[0.2, -0.1, 1.0], [-0.3, 0.25, 1.5], [0.0, 0.0, 2.0]])
COEFFICIENTS = (0.05, -0.01, 0.004, 0.002, 0.01, 0.02, -0.01, 0.003)


def test_every_model_has_the_number_and_parameters_that_colmap_gives_it():
    for number, model in enumerate(colmap.MODELS):
        theirs = pycolmap.Camera(model=model.name, width=32, height=24)
        assert int(theirs.model) == number
        assert len(theirs.params_info.split(",")) == model.parameters


@pytest.mark.parametrize("model", [model for model in colmap.MODELS if model.focals], ids=lambda model: model.name)
@pytest.mark.parametrize("binary", [False, True])
def test_lenses_bend_as_colmap_bends(tmp_path, model, binary):
    values = [*(60.0, 62.0)[: model.focals], 16.5, 12.5, *COEFFICIENTS]
    theirs = pycolmap.Camera(model=model.name, width=32, height=24, params=values[: model.parameters], camera_id=1)
    (tmp_path / "cameras.txt").write_text(f"1 {model.name} 32 24 {' '.join(map(str, theirs.params))}\n")
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 4 1 a.png\n1 1 -1\n")
    (tmp_path / "points3D.txt").touch()
    if binary:
        pycolmap.Reconstruction(str(tmp_path)).write_binary(str(tmp_path))
        for file in tmp_path.glob("*.txt"):
            file.unlink()
    (posed,) = colmap.read(tmp_path)
    ours = project(posed, POINTS)
    np.testing.assert_allclose(ours, [theirs.img_from_cam(point) for point in POINTS], atol=1e-4)


def project(posed, points):
    """Pixels of (P, 3) points in the picture as it was taken."""
    if posed.lens is None:
        c = posed.camera
        return points[:, :2] / points[:, 2:] * [c.fx, c.fy] + [c.cx, c.cy]
    still, bend = np.zeros(3), cv2.fisheye.projectPoints if posed.lens.fisheye else cv2.projectPoints
    arguments = still, still, posed.lens.matrix - TO_CENTRES, posed.lens.coefficients
    return bend(points[:, None], *arguments)[0][:, 0] + 0.5


@pytest.mark.parametrize("write", [write_colmap_text, write_colmap_binary])
def test_what_the_tests_write_is_what_colmap_reads(tmp_path, write):
    model = write(tmp_path, ring(3))
    (model / ("points3D.bin" if write is write_colmap_binary else "points3D.txt")).write_bytes(
        bytes(8) if write is write_colmap_binary else b""
    )
    theirs = sorted(pycolmap.Reconstruction(str(model)).images.values(), key=lambda image: image.name)
    for image, posed in zip(theirs, colmap.read(model), strict=True):
        np.testing.assert_allclose(image.cam_from_world().matrix(), posed.camera.world_to_camera[:3], atol=1e-12)

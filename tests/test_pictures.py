"""What callers draw."""

import re

import pytest

import airgs_codec as airgs
from tests.faces import read_picture, to_bytes
from tests.support.paths import FOX, GOLDEN
from tests.support.regions import is_inside

PACKAGE = GOLDEN / "fox"


def test_a_frame_is_a_png_in_four_lines_and_cameras_are_inside_the_region(tmp_path):
    package = airgs.open_package(PACKAGE)
    picture = airgs.draw(airgs.decode(package, 0), package.cameras[0])
    picture.save(tmp_path / "frame.png")
    assert (read_picture(tmp_path / "frame.png") == to_bytes(picture.rgb)).all() and picture.rgb.std() > 0.05
    region = package.manifest.region
    assert len(package.cameras) == len(region.places) and all(is_inside(region, view) for view in package.cameras)


def test_what_cannot_be_drawn_or_written_is_refused(tmp_path):
    frame, camera = airgs.read(FOX / "000000.ply"), airgs.Camera.look_at((0, 0, -3), (0, 0, 0), size=(16, 16))
    with pytest.raises(airgs.AirgsError, match="camera: expected a Camera, got str 'front'"):
        airgs.draw(frame, "front")
    with pytest.raises(airgs.AirgsError, match="gaussians: expected Gaussians or a mapping"):
        airgs.draw(FOX, camera)
    for name in ("frame.jpg", "none/frame.png"):
        with pytest.raises(airgs.AirgsError, match=re.escape(name)):
            airgs.draw(frame, camera).save(tmp_path / name)
    assert list(tmp_path.iterdir()) == []

"""What callers draw, and packages in notebooks."""

import base64
import re
import shutil

import pytest

import airgs_codec as airgs
from tests.faces import read_picture, to_bytes
from tests.support.mutations import edit_tables, on_disk
from tests.support.paths import FOX, GOLDEN
from tests.support.regions import is_inside
from tests.support.servers import plainly_serving, serving

PACKAGE = GOLDEN / "fox"


def test_a_frame_is_a_png_in_four_lines_and_cameras_are_inside_the_region(tmp_path):
    package = airgs.open_package(PACKAGE)
    picture = airgs.draw(airgs.decode(package, 0), package.cameras[0])
    picture.save(tmp_path / "frame.png")
    assert (read_picture(tmp_path / "frame.png") == to_bytes(picture.rgb)).all() and picture.rgb.std() > 0.05
    region = package.manifest.region
    assert len(package.cameras) == len(region.places) and all(is_inside(region, view) for view in package.cameras)


def test_a_notebook_shows_the_poster_and_escaped_words(demo_package, tmp_path):
    where = shutil.copytree(demo_package, tmp_path / "<i>.airgs")
    on_disk(where, edit_tables(lambda tables: tables.update(attribution="points by <nobody>")))
    page = airgs.open_package(where)._repr_html_()
    (data,) = re.findall('<img src="data:image/jpeg;base64,([^"]*)"', page)
    assert base64.b64decode(data) == (where / "poster.jpg").read_bytes()
    assert "&lt;i&gt;.airgs: 10 frames at 24 a second" in page and "points by &lt;nobody&gt;" in page
    assert "<i>" not in page
    (where / "poster.jpg").unlink()
    assert "<img" not in airgs.open_package(where)._repr_html_()


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


def test_a_notebook_shows_the_player_of_a_package_that_is_served_with_one(tmp_path):
    with serving(PACKAGE) as port:
        served = airgs.open_package(f"http://127.0.0.1:{port}/{PACKAGE.name}")._repr_html_()
    assert f'<iframe src="http://127.0.0.1:{port}/{PACKAGE.name}/"' in served and "<img" not in served
    with plainly_serving(PACKAGE) as port:
        plain = airgs.open_package(f"http://127.0.0.1:{port}")._repr_html_()
    assert "<iframe" not in plain

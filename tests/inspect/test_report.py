"""The page of an encode: what came out beside what was given."""

import re

import pytest

from airgs_codec.decoder.decode import decode_frames
from airgs_codec.inspect.report import write_report
from airgs_codec.media.image import read_picture
from airgs_codec.media.movie import VideoReader
from airgs_codec.package.package import open_package
from airgs_codec.scene.sequence import GaussianSequence
from tests.support.paths import VALID
from tests.support.views import moved


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The folder of a report on a package beside what it decodes to, but for a frame in which some rows are away."""
    package = open_package(VALID / "moving")
    frames = [frame.gaussians for frame in decode_frames(package, 0, 4)]
    frames[2] = moved(frames[2], slice(0, 12), (0.4, 0.2, 0.0))
    folder = tmp_path_factory.mktemp("report") / "made"
    write_report(folder, GaussianSequence.from_arrays(frames, fps=package.manifest.fps), package, [])
    return folder


def test_the_worst_frame_is_named_and_shown(page):
    text = (page / "index.html").read_text()
    assert "frame 2 is the worst" in text
    assert text.index("frame-000002.png") == text.index('<img src="frame-') + len('<img src="')
    assert read_picture(page / "frame-000002.png").shape[1] > 3 * 300  # given, encoded, difference


def test_a_film_shows_both_sides(page):
    film = VideoReader(page / "film.mp4")
    assert film.frames == 4
    width, height = film.size
    assert width > height  # two pictures beside each other


def test_all_that_the_page_names_is_there(page):
    text = (page / "index.html").read_text()
    assert set(re.findall(r'(?:src|href)="([^"]+)"', text)) <= {path.name for path in page.iterdir()}
    assert "jobs.html" not in text

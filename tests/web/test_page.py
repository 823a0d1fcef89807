"""The page that is shipped, with a real package, used as people use it (web/test/pages/page.ts)."""

import numpy as np
import pytest

from airgs_codec.serve.pages import PAGE
from tests.faces import open_package
from tests.support.browser import WEB, build_pages, missing, serve, visit
from tests.support.paths import GOLDEN

FOX = GOLDEN / "fox"
DRIVER = b'<script type="module" src="/web/out/pages/page.js"></script>'

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"not here: {', '.join(missing())}")


@pytest.fixture(scope="module")
def report():
    build_pages()
    page = (PAGE / "player.html").read_bytes() + DRIVER
    folders = {"web": WEB, "page": PAGE, "scenes": FOX.parent}
    with serve(folders, {"/page/player.html": lambda: page}) as site:
        seen = visit(f"{site.url}/page/player.html?src=/scenes/{FOX.name}/")
    assert seen.complaints() == []
    return seen.report


def difference(pictures):
    return float(np.abs(np.subtract(pictures["before"], pictures["after"])).mean())


def test_the_page_bears_the_name_of_the_package_until_there_is_a_picture(report):
    assert (report["named"], report["title"]) == ("fox", "fox \u2013 airgs player")


def test_a_drag_turns_the_camera_and_the_picture_and_a_key_goes_back(report):
    look = report["look"]
    first = open_package(FOX).manifest.region.places[0].position
    assert look["first"] == pytest.approx(first, abs=1e-5)
    assert np.linalg.norm(np.subtract(look["turned"], look["first"])) > 0.02
    assert difference(look) > 0.5
    assert look["home"] == pytest.approx(look["first"], abs=1e-5)


def test_scrubbing_shows_another_frame(report):
    scrub, m = report["scrub"], open_package(FOX).manifest
    assert scrub["time"] == pytest.approx(int(0.7 * m.frames) / float(m.fps))
    assert difference(scrub) > 0.05


def test_a_quality_of_the_menu_is_soon_on_the_screen(report):
    choose = report["choose"]
    assert choose["shown"] == choose["name"] and "+" in choose["name"]
    assert "dB" in choose["label"]


def test_it_fills_the_window_of_a_phone(report):
    phone = report["phone"]
    sides = ("left", "top", "width", "height")
    assert [phone["element"][side] for side in sides] == [0, 0, 390, 844]
    assert phone["bar"]["left"] >= 0 and phone["bar"]["right"] <= 390 and phone["bar"]["bottom"] <= 844
    assert phone["page"] == [390, 844]
    assert phone["touchAction"] == "none"

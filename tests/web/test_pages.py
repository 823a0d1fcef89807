"""The pages that are published: they play with nothing of a test in them, ask nobody else, and are used by people."""

import shutil
from urllib.parse import quote, urlsplit

import numpy as np
import pytest

from tests.faces import export_page, open_package
from tests.support.browser import WEB, Answer, build_pages, missing, serve, visit
from tests.support.page import SHIPPED, asking, shipped_page
from tests.support.paths import CORPUS, GOLDEN, VALID
from tests.support.servers import plainly_serving, serving

SHOWCASE = CORPUS / "showcase"
FOX = GOLDEN / "fox"
pytestmark = pytest.mark.skipif(bool(missing()), reason=f"not here: {', '.join(missing())}")


def check_plays(url):
    """The page plays, complains of nothing, and asks only the server it came from."""
    seen = visit(url, asking())
    assert seen.complaints() == []
    assert seen.report["frames"] >= 3 and not seen.report["paused"]
    assert {urlsplit(asked).netloc for asked in seen.report["asked"] if asked.startswith("http")} <= {
        urlsplit(url).netloc
    }


def test_the_page_of_the_server_plays():
    with serving(FOX) as port:
        check_plays(f"http://127.0.0.1:{port}/player.html?src={quote('/fox/')}")


def test_an_exported_site_plays_from_a_folder_of_a_plain_server(tmp_path):
    export_page([FOX], tmp_path / "some" / "where")
    with plainly_serving(tmp_path) as port:
        check_plays(f"http://127.0.0.1:{port}/some/where/")


def test_the_example_of_a_page_of_ones_own_plays():
    with serving(FOX) as port:
        text = (WEB / "examples" / "embed.html").read_text().replace("127.0.0.1:8000", f"127.0.0.1:{port}")
        page = Answer(text.replace("fox.airgs", "fox").encode(), headers={"Content-Type": "text/html"})
        with serve({}, {"/": page}) as site:
            seen = visit(f"{site.url}/", asking())
    assert seen.complaints() == []
    assert seen.report["frames"] >= 3


def check_laid_out(url):
    """As many cards abreast as there is room, whatever their names, with posters of one shape."""
    seen = visit(url, asking(widths=[390, 768, 1280]))
    assert seen.complaints() == []
    shown = seen.report["seen"]
    assert [one["abreast"] for one in shown] == [1, 2, 4]
    for one in shown:
        assert one["needs"] <= one["width"] and len(one["loaded"]) == 2 and all(one["loaded"])
        assert {round(picture["width"] / picture["height"], 2) for picture in one["pictures"]} == {1.33}


def test_lists_of_packages_fit_phones_tablets_and_desks(tmp_path):
    shown = [SHOWCASE / "fox.airgs", SHOWCASE / "head.airgs"]
    names = ["moving", "a name_" + 9 * "without_room_"]
    plain = [shutil.copytree(VALID / "moving", tmp_path / "plain" / name) for name in names]
    with serving(*shown, *plain) as port:
        check_laid_out(f"http://127.0.0.1:{port}/")
    export_page([*shown, *plain], tmp_path / "site")
    with plainly_serving(tmp_path / "site") as port:
        check_laid_out(f"http://127.0.0.1:{port}/")


# The page that is shipped, used by mouse and keys (web/test/pages/page.ts)


@pytest.fixture(scope="module")
def report():
    build_pages()
    folders = {"web": WEB, "page": SHIPPED, "scenes": FOX.parent}
    with serve(folders, {"/page/player.html": shipped_page("page")}) as site:
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

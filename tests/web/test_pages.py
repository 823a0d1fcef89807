"""The pages that are published: they play with nothing of a test in them, ask nobody else, and are used by people."""

import shutil
from urllib.parse import urlsplit

import numpy as np
import pytest

from tests.faces import export_page, open_package
from tests.support.browser import WEB, Answer, build_pages, missing, serve, visit_all
from tests.support.page import SHIPPED, asking, shipped_page
from tests.support.paths import CORPUS, GOLDEN, VALID
from tests.support.servers import plainly_serving, serving

SHOWCASE = CORPUS / "showcase"
FOX = GOLDEN / "fox"
pytestmark = pytest.mark.skipif(bool(missing()), reason=f"not here: {', '.join(missing())}")


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    build_pages()
    folder, shown = tmp_path_factory.mktemp("pages"), [SHOWCASE / "fox.airgs", SHOWCASE / "head.airgs"]
    names = ["moving", "a name_" + 9 * "without_room_"]
    shown += [shutil.copytree(VALID / "moving", folder / "plain" / name) for name in names]
    export_page([FOX], folder / "some" / "where")
    export_page(shown, folder / "site")
    with serving(FOX) as fox, serving(*shown) as many, plainly_serving(folder) as plain:
        text = (WEB / "examples" / "embed.html").read_text().replace("127.0.0.1:8000", f"127.0.0.1:{fox}")
        embedded = Answer(text.replace("fox.airgs", "fox").encode(), headers={"Content-Type": "text/html"})
        made = {"/": embedded, "/page/player.html": shipped_page("page")}
        with serve({"web": WEB, "page": SHIPPED, "scenes": FOX.parent}, made) as site:
            own = site.url.removeprefix("http://127.0.0.1:")
            pages = {
                "of the server": (fox, "player.html?src=%2Ffox%2F", asking()),
                "exported": (plain, "some/where/", asking()),
                "embedded": (own, "", asking()),
                "list": (many, "", asking(widths=[390, 768, 1280])),
                "exported list": (plain, "site/", asking(widths=[390, 768, 1280])),
                "used": (own, "page/player.html?src=/scenes/fox/", ""),
            }
            visits = visit_all([(f"http://127.0.0.1:{port}/{path}", script) for port, path, script in pages.values()])
    assert [one.complaints() for one in visits] == [[]] * len(pages)
    return {name: (f"127.0.0.1:{pages[name][0]}", one.report) for name, one in zip(pages, visits, strict=True)}


@pytest.mark.parametrize("page", ["of the server", "exported", "embedded"])
def test_it_plays_and_asks_only_the_server_it_came_from(seen, page):
    server, report = seen[page]
    assert report["frames"] >= 3
    if page != "embedded":
        assert not report["paused"]
        assert {urlsplit(asked).netloc for asked in report["asked"] if asked.startswith("http")} <= {server}


@pytest.mark.parametrize("page", ["list", "exported list"])
def test_lists_of_packages_fit_phones_tablets_and_desks(seen, page):
    """As many cards abreast as there is room, whatever their names, with posters of one shape."""
    shown = seen[page][1]["seen"]
    assert [one["abreast"] for one in shown] == [1, 2, 4]
    for one in shown:
        assert one["needs"] <= one["width"] and len(one["loaded"]) == 2 and all(one["loaded"])
        assert {round(picture["width"] / picture["height"], 2) for picture in one["pictures"]} == {1.33}


# The page that is shipped, used by mouse and keys (web/test/pages/page.ts)


def difference(pictures):
    return float(np.abs(np.subtract(pictures["before"], pictures["after"])).mean())


def test_the_page_bears_the_name_of_the_package_until_there_is_a_picture(seen):
    report = seen["used"][1]
    assert (report["named"], report["title"]) == ("fox", "fox \u2013 airgs player")


def test_a_drag_turns_the_camera_and_the_picture_and_a_key_goes_back(seen):
    look = seen["used"][1]["look"]
    assert look["first"] == pytest.approx(open_package(FOX).manifest.region.places[0].position, abs=1e-5)
    assert np.linalg.norm(np.subtract(look["turned"], look["first"])) > 0.02
    assert difference(look) > 0.5
    assert look["home"] == pytest.approx(look["first"], abs=1e-5)


def test_scrubbing_shows_another_frame_and_a_quality_of_the_menu_is_soon_on_the_screen(seen):
    scrub, choose, m = seen["used"][1]["scrub"], seen["used"][1]["choose"], open_package(FOX).manifest
    assert scrub["time"] == pytest.approx(int(0.7 * m.frames) / float(m.fps))
    assert difference(scrub) > 0.05
    assert choose["shown"] == choose["name"] and "+" in choose["name"] and "dB" in choose["label"]


def test_it_fills_the_window_of_a_phone(seen):
    phone = seen["used"][1]["phone"]
    bar = phone["bar"]
    assert [phone["element"][side] for side in ("left", "top", "width", "height")] == [0, 0, 390, 844]
    assert bar["left"] >= 0 and bar["right"] <= 390 and bar["bottom"] <= 844
    assert (phone["page"], phone["touchAction"]) == ([390, 844], "none")

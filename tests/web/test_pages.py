"""The pages that are published: they play with nothing of a test in them, ask nobody else, and are used by people."""

import base64
import shutil
from urllib.parse import urlsplit

import numpy as np
import pytest

from tests.faces import export_page, mse, open_package, psnr, read_picture, write_ply
from tests.support.browser import WEB, Answer, build_pages, missing, serve, visit_all
from tests.support.page import SHIPPED, asking, shipped_page
from tests.support.paths import CORPUS, GOLDEN, VALID
from tests.support.scenes import random_gaussians
from tests.support.servers import plainly_serving, serving

SHOWCASE = CORPUS / "showcase"
FOX = GOLDEN / "fox"
pytestmark = pytest.mark.skipif(bool(missing()), reason=f"not here: {', '.join(missing())}")


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    build_pages()
    build_pages("examples")
    folder, shown = tmp_path_factory.mktemp("pages"), [SHOWCASE / "fox.airgs", SHOWCASE / "head.airgs"]
    names = ["moving", "a name_" + 9 * "without_room_"]
    shown += [shutil.copytree(VALID / "moving", folder / "plain" / name) for name in names]
    export_page([FOX], folder / "some" / "where")
    export_page(shown, folder / "site")
    with serving(FOX) as fox, serving(*shown) as many, plainly_serving(folder) as plain:
        text = (WEB / "examples" / "embed.html").read_text().replace("127.0.0.1:8000", f"127.0.0.1:{fox}")
        embedded = Answer(text.replace("fox.airgs", "fox").encode(), headers={"Content-Type": "text/html"})
        made = {"/": embedded, "/page/player.html": shipped_page("page"), "/favicon.ico": b""}
        with serve({"web": WEB, "page": SHIPPED, "scenes": FOX.parent}, made) as site:
            own = site.url.removeprefix("http://127.0.0.1:")
            pages = {
                "of the server": (fox, "player.html?src=%2Ffox%2F", asking()),
                "exported": (plain, "some/where/", asking()),
                "embedded": (own, "", asking()),
                "of npm": (own, "web/out/examples/", asking()),
                "list": (many, "", asking(widths=[390, 768, 1280])),
                "exported list": (plain, "site/", asking(widths=[390, 768, 1280])),
                "used": (own, "page/player.html?src=/scenes/fox/", ""),
            }
            visits = visit_all([(f"http://127.0.0.1:{port}/{path}", script) for port, path, script in pages.values()])
    assert [one.complaints() for one in visits] == [[]] * len(pages)
    return {name: (f"127.0.0.1:{pages[name][0]}", one.report) for name, one in zip(pages, visits, strict=True)}


@pytest.mark.parametrize("page", ["of the server", "exported", "embedded", "of npm"])
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


def ray(camera, x, y, width=480, height=270):
    """The direction in which a pixel of a page is seen."""
    forward, up = np.array(camera["forward"]), np.array(camera["up"])
    high = 2 * np.tan(np.radians(camera["fovY"]) / 2) / height
    return forward + high * ((x - width / 2) * np.cross(forward, up) + (height / 2 - y) * up)


@pytest.fixture(scope="module")
def hand(demo_package, tmp_path_factory):
    """What a hand does to a package of the embedded scene and to a still (web/test/pages/hand.ts), and pictures."""
    build_pages()
    build_pages("examples")
    shots = tmp_path_factory.mktemp("shots")
    folders = {"web": WEB, "page": SHIPPED, "scenes": demo_package.parent, "valid": VALID}
    with serve(folders, {"/page/player.html": shipped_page("hand")}) as site:
        sources = (f"/scenes/{demo_package.name}/&shots={shots}", "/valid/placed/")
        visits = visit_all([(f"{site.url}/page/player.html?src={source}", "") for source in sources])
    assert [one.complaints() for one in visits] == [[], []]
    return {"scene": visits[0].report, "still": visits[1].report, "shots": shots}


def test_a_still_has_no_transport_is_drawn_whole_and_costs_bytes(hand):
    still = hand["still"]
    assert not still["play"] and not still["line"] and not still["big"] and still["paused"]
    assert still["time"] == "1 frame" and still["width"] == 480
    assert "kB" in still["menu"] and "bit/s" not in still["menu"]
    assert hand["scene"]["play"] and hand["scene"]["line"]


@pytest.mark.parametrize("window", ["wide", "tall"])
def test_the_poster_is_the_first_picture(hand, window):
    shots = (read_picture(hand["shots"] / f"{window}-{name}.png") for name in ("poster", "first"))
    poster, first = (shot[..., :3] / np.float32(255) for shot in shots)
    assert first.std() > 0.1 and psnr(mse(poster, first)) > 27


def test_a_drag_turns_about_the_subject_which_fills_a_phone(hand):
    middles = [seen["middle"] for seen in hand["scene"]["turned"]]
    assert np.ptp(middles) < 0.05
    assert hand["scene"]["tall"]["width"] > 0.6


def test_a_double_click_looks_at_what_is_there_and_drags_turn_about_it_then(hand):
    before, looked, around = (hand["scene"][name] for name in ("before", "looked", "around"))
    aim = ray(before, 290, 110)
    assert looked["position"] == pytest.approx(before["position"], abs=1e-6)
    assert looked["forward"] == pytest.approx(aim / np.linalg.norm(aim), abs=1e-3)
    ways, places = (np.array([one[name] for one in (looked, around)]) for name in ("forward", "position"))
    depths, off, *_ = np.linalg.lstsq(ways.T * [1, -1], places[1] - places[0], rcond=None)
    assert off < 1e-6 and 1.5 < depths[0] < 3.5  # the axes of both views meet in the scene
    assert 0.5 < hand["scene"]["framed"]["width"] < 0.95  # and F shows all of it


DROP = """if (window === top) window.report = (async () => {
  const wait = () => new Promise((resolve) => setTimeout(resolve, 50));
  const list = document.createElement("iframe");
  await new Promise((resolve) => addEventListener("load", resolve));
  document.body.append(Object.assign(list, { src: "/" }));
  const seen = () => list.contentDocument;
  while (!seen().querySelector("label") || seen().readyState !== "complete") await wait();
  const dataTransfer = new DataTransfer();
  dataTransfer.items.add(new File([await (await fetch("data:;base64,DATA")).blob()], "small.ply"));
  seen().dispatchEvent(new DragEvent("drop", { dataTransfer }));
  while (!(seen()?.querySelector("airgs-player")?.player?.stats.framesShown > 0)) await wait();
  return list.contentWindow.location.search;
})();"""


def test_a_file_that_is_dropped_on_the_list_plays(tmp_path):
    write_ply(tmp_path / "small.ply", random_gaussians(60))
    (tmp_path / "home").mkdir()
    data = base64.b64encode((tmp_path / "small.ply").read_bytes()).decode()
    with serving(home=tmp_path / "home") as port:
        [seen] = visit_all([(f"http://127.0.0.1:{port}/airgs-list.js", DROP.replace("DATA", data))])
    assert (seen.report, seen.failed) == ("?src=small.airgs/", [])

"""The player on a page: what it shows, and what it does when something goes wrong."""

import json
import shutil
from urllib.parse import urlencode

import pytest

from tests.faces import decode, open_package, render
from tests.support.browser import WEB, build_pages, missing, serve, visit
from tests.support.paths import GOLDEN, VALID
from tests.support.player_page import LEAST_DB, PAGE, camera_of, decibels

KNOWN = ("WebGL: CONTEXT_LOST",)  # what tests do

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"not here: {', '.join(missing())}")


@pytest.fixture(scope="module", autouse=True)
def _pages():
    build_pages()


@pytest.fixture(scope="module")
def fox():
    return open_package(GOLDEN / "fox")


def look(folder, check, **query):
    """What the page reports of a check on a package in a folder, and the paths that it asked for (`asked`)."""
    with serve({"web": WEB, "package": folder}, {"/player.html": lambda: PAGE}) as site:
        seen = visit(f"{site.url}/player.html?{urlencode({'src': '/package/', 'check': check} | query)}")
    assert seen.complaints(KNOWN) == []
    assert seen.report["error"] == 0  # of WebGL
    return seen.report | {"asked": [path for path, _ in site.answers]}


def test_every_frame_of_a_pass_is_shown_or_counted_as_dropped(fox):
    report = look(fox.files.path, "once")
    stats = report["stats"]
    assert report["problems"] == []
    assert stats["framesShown"] <= fox.manifest.frames <= stats["framesShown"] + stats["framesDropped"]
    assert report["events"][-1] == "ended"
    assert report["currentTime"] == pytest.approx((fox.manifest.frames - 1) / float(fox.manifest.fps))


def test_a_package_without_measured_quality_plays_its_best_rung():
    report = look(VALID / "paged", "once")
    assert (report["problems"], report["events"][-1]) == ([], "ended")
    assert set(report["rungs"]) == {"Q0+L0"}


def test_a_loop_goes_on_over_changes_of_group_without_a_dark_picture(fox):
    report = look(fox.files.path, "loop")
    assert report["problems"] == []
    assert report["stats"]["framesShown"] > fox.manifest.frames
    assert report["pictures"] > 10
    assert report["darkest"] > 0.8 * report["brightest"] > 10


def assert_drawn_as_by_the_cpu_renderer(package, rung, frames):
    """Frames that are sought in one rung, before the background of the package."""
    quality, level = rung
    m = package.manifest
    name = f"{m.qualities[quality].id}+{m.levels[level].id}"
    report = look(package.files.path, "seek", frames=json.dumps(frames), rung=name, fps=float(m.fps))
    assert report["paused"] and [p["frame"] for p in report["pictures"]] == frames
    for seen in report["pictures"]:
        shown = decode(package, seen["frame"], level=level, key_quality=quality)
        assert decibels(seen["picture"], render(shown, camera_of(package, report)).rgb) >= LEAST_DB


@pytest.mark.parametrize("rung", [(0, 0), (1, 1)])
def test_a_frame_that_is_sought_is_what_the_cpu_renderer_draws(fox, rung):
    assert_drawn_as_by_the_cpu_renderer(fox, rung, [3, 0, 2, 1])


def test_a_frame_of_a_group_that_keeps_rows_is_sought():
    room = open_package(GOLDEN / "room")
    assert [group.keeps for group in room.manifest.groups] == [None, 1]
    assert_drawn_as_by_the_cpu_renderer(room, (1, 1), [3, 0, 2, 1])


@pytest.mark.parametrize("background", [[1, 1, 1], [1, 0.5, 0]])
def test_the_background_of_the_package_is_behind_the_scene(fox, tmp_path, background):
    folder = shutil.copytree(fox.files.path, tmp_path / "package")
    root = json.loads((folder / "airgs.json").read_text())
    root["region"]["background"] = background
    (folder / "airgs.json").write_text(json.dumps(root))
    assert_drawn_as_by_the_cpu_renderer(open_package(folder), (0, 0), [1])


def test_a_rung_from_the_menu_is_soon_on_the_screen(fox):
    m = fox.manifest
    names = [f"{m.qualities[q].id}+{m.levels[j].id}" for q, j in [(1, 1), (0, 0), (1, 0)]]
    report = look(fox.files.path, "menu", names=json.dumps(names))
    assert report["problems"] == []
    assert report["rungs"][-1] == names[-1]


def test_after_the_loss_of_the_webgl_context_it_goes_on(fox):
    report = look(fox.files.path, "lost")
    assert report["problems"] == []
    assert report["brightness"] > 10


def test_nothing_is_shown_while_the_page_is_hidden(fox):
    report = look(fox.files.path, "hidden")
    assert report["before"] == report["after"]
    assert report["problems"] == []

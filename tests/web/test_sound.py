"""The sound of a package in Chromium: until somebody touches the page, in a stall, and where it cannot be had."""

import shutil
import threading
from functools import partial

import pytest

from tests.faces import sound_path
from tests.support.browser import Answer, missing, visit_all
from tests.support.page import asking, look, off_s
from tests.support.servers import serving

FPS = 25
SECONDS = 6  # of the package
MOST_S = 0.04  # between picture and sound

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"not here: {', '.join(missing())}")


@pytest.fixture(scope="module")
def chirping(package_of):
    return package_of("chirping")


def hear(folder, check, made=None, **query):
    return look("sound", {"package": folder}, made, src="/package/", check=check, **query)


def test_it_is_muted_until_somebody_touches_the_page(chirping):
    """The page of the server, under its policy; that scripts of a test count as touches is hidden."""
    muted = {("button", "button"): [True, False, True], ("m", "m"): [True, False, True], ("scene",): [True, False]}
    with serving(chirping) as port:
        url = f"http://127.0.0.1:{port}/player.html?src=/{chirping.name}/"
        visits = visit_all([(url, asking(touches=touches)) for touches in muted])
    assert [seen.failed for seen in visits] == [[]] * len(muted)
    assert [seen.report["seen"] for seen in visits] == [*muted.values()]
    assert [seen.report["attribute"] for seen in visits] == [seen[-1] for seen in muted.values()]


def test_a_stall_is_silent_and_sound_goes_on_with_the_pictures(chirping):
    told = threading.Event()

    def late(path):
        told.wait(60)
        return Answer(path.read_bytes())

    delayed = chirping.glob("delta/*/2.m4s")
    made = {f"/package/{path.relative_to(chirping).as_posix()}": partial(late, path) for path in delayed}
    report, asked = hear(chirping, "stall", made | {"/go": lambda: told.set() or b"gone"}, loop=0)
    assert report["waiting"]["stalled"] and report["waiting"]["loud"] == 0
    assert report["stats"]["stalls"] == 1 and report["problems"] == []
    assert len(report["after"]) >= 4 and off_s(report["after"], SECONDS) <= MOST_S
    assert asked.count(f"/package/{sound_path(1)}") == 1


def test_a_browser_that_does_not_decode_it_says_so_and_plays_pictures(chirping):
    report, _ = hear(chirping, "lacking")
    [problem] = report["problems"]
    assert "does not decode the sound" in problem["message"] and not problem["fatal"]
    assert report["stats"]["framesShown"] > 5 and not report["hasSound"]


def test_a_group_whose_sound_is_broken_is_silent(chirping, tmp_path):
    """The others are heard, and no picture is lost."""
    folder = shutil.copytree(chirping, tmp_path / "package")
    (folder / sound_path(2)).write_bytes(b"no sound")
    report, _ = hear(folder, "beside", looks=6)
    moments = [one["picture"] for one in report["played"]]
    assert not any(1.1 < moment < 1.95 for moment in moments) and min(moments) < 1.1 and max(moments) > 1.95
    assert off_s(report["played"], SECONDS) <= MOST_S and report["stats"]["framesDropped"] < 3 * FPS

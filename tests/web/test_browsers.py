"""Packages play alike in Chromium, Firefox and WebKitGTK: what each of them decodes, draws, seeks and repeats."""

import json
from collections import Counter
from dataclasses import replace
from hashlib import sha256
from types import SimpleNamespace
from urllib.parse import urlencode

import pytest

from airgs_codec.media.h264 import open_segment
from airgs_codec.serve.pages import PAGE as SHIPPED
from tests.faces import decode, open_package, render
from tests.support import media_page, player_page
from tests.support.browser import WEB, Answer, build_pages, missing
from tests.support.browsers import BROWSERS, REPORT, play
from tests.support.digests import lined_files
from tests.support.paths import CORPUS, GOLDEN, VALID

DECODED = ("golden/fox", "golden/room", "valid/lined", "valid/moving", "valid/paged")
FRAMES = [3, 0, 2, 1]
FOX = open_package(GOLDEN / "fox")
FOX_FILES = [path for path in FOX.files.path.rglob("*") if path.is_file()]
UNCACHED = {"Cache-Control": "no-store"}  # what is not fetched again is kept by the player itself
RUNGS = [f"{quality.id}+{level.id}" for quality in FOX.manifest.qualities for level in FOX.manifest.levels]
TOOLS = [what for what in missing() if what != "chromium"]
SHOWS = """<script type="module">
const element = document.querySelector("airgs-player");
const shown = () => element.player?.stats.framesShown > 5 || element.shadowRoot.querySelector(".card");
window.report = (async () => {
  while (!shown()) await new Promise((resolve) => setTimeout(resolve, 50));
  return { frames: element.player.stats.framesShown, trouble: element.shadowRoot.querySelector(".card")?.innerText };
})();
</script>"""

KEYFRAMES = [{"t": t, "position": [x, 1.0, 2.5], "focus": [0, 0.4, 0]} for t, x in ((0, 0.0), (30, 1.0))]
BESIDE = f"""<!doctype html><script type="module" src="airgs-player.js"></script>
<airgs-player src="/golden/fox/" quality="{RUNGS[0]}" split="{RUNGS[-1]}" view-region="free" autoplay loop controls
  path='data:application/json,{json.dumps({"keyframes": KEYFRAMES})}'></airgs-player>
<script type="module">
const element = document.querySelector("airgs-player");
const find = (selector) => element.shadowRoot.querySelector(selector);
const goes = () => element.player?.stats.framesShown > 5 && find(".seam:not([hidden])") && find(".menu");
window.report = (async () => {{
  while (!goes() && !find(".card")) await new Promise((resolve) => setTimeout(resolve, 50));
  const {{ camera, stats }} = element.player;
  return {{ camera, frames: stats.framesShown, labels: find(".seam")?.textContent, trouble: find(".card")?.innerText }};
}})();
</script>"""

pytestmark = pytest.mark.skipif(bool(TOOLS), reason=f"not here: {', '.join(TOOLS)}")


def checking(check, **query):
    return f"/player.html?{urlencode({'src': '/fox/', 'check': check} | query)}"


VISITS = {
    "luma": "/media.html",
    "page": "/page/player.html?src=/golden/fox/",
    "head": "/page/player.html?src=/showcase/head.airgs/",
    "beside": "/page/beside.html",
    "once": checking("once"),
    "seek": checking("seek", frames=json.dumps(FRAMES), rung=RUNGS[-1], fps=float(FOX.manifest.fps)),
    "loop": checking("loop", seconds=3),
    "forgets": checking("play", kept=1, frames=10 * FOX.manifest.frames, seconds=60),
    "menu": checking("menu", names=json.dumps([RUNGS[-1], RUNGS[0], RUNGS[1]])),
}


@pytest.fixture(scope="module", params=BROWSERS, ids=lambda browser: browser.name)
def seen(request):
    """What the pages report in a browser, what each of them asked for, and the version of the browser."""
    browser = request.param
    if why := browser.missing():
        pytest.skip(why)
    build_pages()
    plan = json.dumps([{"name": name, "task": "luma", "url": name} for name in DECODED]).encode()
    shipped = (SHIPPED / "player.html").read_bytes() + SHOWS.encode()
    pages = {
        "/media.html": media_page.PAGE,
        "/page/beside.html": BESIDE.encode(),
        "/player.html": player_page.PAGE,
        "/page/player.html": shipped,
    }
    made = {path: lambda page=page: page + REPORT.encode() for path, page in pages.items()}
    for path in FOX_FILES:
        address = f"/fox/{path.relative_to(FOX.files.path).as_posix()}"
        made[address] = lambda path=path: Answer(path.read_bytes(), headers=UNCACHED)
    folders = {"web": WEB, "page": SHIPPED, "golden": GOLDEN, "valid": VALID, "showcase": CORPUS / "showcase"}
    reports, asked = play(browser, list(VISITS.values()), folders, made | {"/plan.json": lambda: plan})
    named = {name: dict(zip(VISITS, found, strict=True)) for name, found in (("reports", reports), ("asked", asked))}
    return SimpleNamespace(**named, version=browser.version())


def test_a_browser_that_is_not_there_is_named_with_what_to_install():
    firefox = replace(BROWSERS[1], programs=("no-such-program",), needs=("Xvfb-9", "/no/such/*.so"))
    assert firefox.missing().startswith(
        "Firefox: not here: no-such-program, Xvfb-9, /no/such/*.so (apt-get install fire"
    )
    assert replace(firefox, programs=("sh",), needs=("cat",)).missing() == ""


@pytest.mark.parametrize("name", DECODED)
def test_decoded_pictures_are_those_of_python(seen, name):
    report = seen.reports["luma"][name]
    assert report.get("luma") in ("exact", "invertible"), report
    package = open_package({"golden": GOLDEN, "valid": VALID}[name.split("/")[0]] / name.split("/")[1])
    assert report["found"]
    lined = lined_files(package.manifest)
    assert bool(lined) == (name in ("valid/lined", "valid/moving"))
    for path, digests in report["found"].items():
        _, pictures = open_segment(package.read(path), path)
        expected = [sha256(picture.tobytes()).hexdigest() for picture in pictures]
        assert digests == expected[path in lined :], path  # slopes are no frame


@pytest.mark.parametrize("page", ["page", "head"])
def test_the_shipped_page_shows_the_fox_and_the_talking_head(seen, page, record_property):
    record_property("browser", seen.version)
    report = seen.reports[page]
    assert report["frames"] > 5 and "trouble" not in report


def test_two_rungs_are_shown_beside_each_other_along_a_path(seen):
    report = seen.reports["beside"]
    assert report["frames"] > 5 and "trouble" not in report and report["labels"].count("dB") == 2
    assert 0 < report["camera"]["position"][0] < 1


def test_it_plays_to_its_end(seen):
    report, m = seen.reports["once"], FOX.manifest
    assert (report["problems"], report["events"][-1], report["error"]) == ([], "ended", 0)
    assert (
        report["stats"]["framesShown"] <= m.frames <= report["stats"]["framesShown"] + report["stats"]["framesDropped"]
    )
    assert report["currentTime"] == pytest.approx((m.frames - 1) / float(m.fps))


def test_frames_that_are_sought_are_what_the_cpu_renderer_draws(seen):
    report, m = seen.reports["seek"], FOX.manifest
    assert [picture["frame"] for picture in report["pictures"]] == FRAMES
    camera = player_page.camera_of(FOX, report)
    for picture in report["pictures"]:
        shown = decode(FOX, picture["frame"], level=len(m.levels) - 1, key_quality=len(m.qualities) - 1)
        assert player_page.decibels(picture["picture"], render(shown, camera).rgb) >= player_page.LEAST_DB


def asked_of_fox(seen, visit):
    return Counter(path for path in seen.asked[visit] if path.startswith("/fox/"))


def test_it_is_repeated_without_a_dark_picture_and_nothing_is_fetched_twice(seen):
    report = seen.reports["loop"]
    assert report["problems"] == [] and report["stats"]["framesShown"] > 3 * FOX.manifest.frames
    assert report["darkest"] > 0.8 * report["brightest"] > 10
    assert set(asked_of_fox(seen, "loop").values()) == {1}


def test_more_than_is_kept_plays_on(seen):
    report = seen.reports["forgets"]
    assert report["problems"] == [] and report["stats"]["framesShown"] >= 10 * FOX.manifest.frames
    assert max(asked_of_fox(seen, "forgets").values()) >= 10


def test_rungs_are_switched(seen):
    report = seen.reports["menu"]
    assert report["problems"] == [] and report["rungs"][-1] == RUNGS[1]

"""The player on a page under conditions as people have them: links, servers, growing packages, undecided viewers."""

import asyncio
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, field, replace
from urllib.parse import urlencode

import numpy as np
import pytest
from starlette.datastructures import MutableHeaders
from starlette.responses import Response

from tests.faces import Groups, Trace, open_package, pack_json, root_of
from tests.support.browser import WEB, build_pages, missing, serve, visit
from tests.support.paths import GOLDEN
from tests.support.repeated import write_repeated
from tests.support.servers import serving
from tools.lab.relay import shaped

WRONG = 0  # in the place of a status: the file with a wrong byte
SILENT = 1  # its headers, and no byte for as long as the answer to the next question is the same
LOOK_S = 0.02
Fault = Callable[[str, int], int | None]  # path below the package, number of the request -> status or one of these


def outage(trigger, seconds, status):
    """A fault of all answers for a while, from the first request for a file on."""
    begun = []

    def fault(path, _):
        if path == trigger and not begun:
            begun.append(time.monotonic())
        return status if begun and time.monotonic() < begun[0] + seconds else None

    return fault


@dataclass
class Moods:
    """What a server does with requests, none of whose answers a browser keeps."""

    fault: Fault = lambda path, number: None
    asked: Counter[str] = field(default_factory=Counter)  # paths below the package

    def around(self, app):
        async def moody(scope, receive, send):
            if scope["type"] != "http":
                await app(scope, receive, send)
                return
            path = scope["path"].split("/", 2)[-1]
            self.asked[path] += 1
            fault = self.fault(path, self.asked[path])
            if fault not in (None, WRONG, SILENT):
                await Response("sorry", fault, {"Access-Control-Allow-Origin": "*"})(scope, receive, send)
                return

            async def send_on(message):
                if message["type"] == "http.response.start":
                    MutableHeaders(scope=message)["Cache-Control"] = "no-store"
                elif fault == WRONG and message.get("body"):
                    message["body"] = bytes([message["body"][0] ^ 1]) + message["body"][1:]
                while message["type"] == "http.response.body" and self.fault(path, self.asked[path]) == SILENT:
                    await asyncio.sleep(LOOK_S)
                await send(message)

            await app(scope, receive, send_on)

        return moody


class Switch(ExitStack):
    """A server that can be away and come back at the same port."""

    def __init__(self, folder, moods):
        super().__init__()
        self.folder, self.moods, self.port = folder, moods, 0
        self.begin()

    def begin(self):
        self.port = self.enter_context(serving(self.folder, port=self.port, around=self.moods.around))
        return b"begun"

    def end(self):
        self.close()
        return b"ended"


PAGE = (
    b'<!doctype html><link rel="icon" href="data:,"><script type="module" src="/web/out/pages/conditions.js"></script>'
)
FPS = 2  # a group a second
AWAY = ("Failed to load resource", "ERR_")  # what browsers say of servers that are not there, and of what was given up

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"not here: {', '.join(missing())}")


@pytest.fixture(scope="module", autouse=True)
def _pages():
    build_pages()


@pytest.fixture(scope="module")
def fox(tmp_path_factory):
    """Makes the fox walk for some seconds; a group with one segment is a second."""
    made = {}

    def make(seconds):
        if seconds not in made:
            folder = tmp_path_factory.mktemp("fox") / f"{seconds}.airgs"
            made[seconds] = write_repeated(open_package(GOLDEN / "fox"), folder, seconds // 2, FPS)
        return made[seconds]

    return make


def look(folder, check, moods=None, link=None, known=(), **query):
    """What the page reports of a check on a package, and how often each file was asked for."""
    moods = moods or Moods()
    with (
        Switch(folder, moods) as server,
        shaped(server.port, link, 0.03) if link else nullcontext(server.port) as port,
    ):
        told = {"/page.html": lambda: PAGE, "/end": server.end, "/begin": server.begin}
        src = f"http://127.0.0.1:{port}/{folder.name}/"
        with serve({"web": WEB}, told) as site:
            seen = visit(f"{site.url}/page.html?{urlencode({'src': src, 'check': check, **query})}")
    assert seen.complaints(known) == []
    assert seen.report["unhandled"] == []
    assert seen.report.get("error", 0) == 0  # of WebGL
    return seen.report


def trace(*parts):
    """A link by (seconds, bit/s); the last rate holds."""
    lengths, rates = zip(*parts, strict=True)
    starts = np.concatenate([[0.0], np.cumsum(lengths)[:-1]])
    return Trace("test", starts, np.array(rates, float), sum(lengths), end="hold")


class Growth:
    """An airgs.json with a group more each second from the first time that somebody asks, up to all that there are."""

    def __init__(self, folder, first):
        self.manifest, self.first, self.start = open_package(folder).manifest, first, None

    def root(self):
        self.start = self.start or time.monotonic()
        m, count = self.manifest, self.first + int(time.monotonic() - self.start)
        if count >= len(m.groups):
            return pack_json(root_of(m))
        groups = m.groups[:count]
        return pack_json(root_of(replace(m, live=True, frames=groups[-1].stop, groups=Groups.of(groups))))


def test_a_growing_package_is_joined_at_its_newest_group_and_followed_to_its_end(fox):
    folder, groups, first = fox(16), 16, 4
    growth = Growth(folder, first)
    made = {"/page.html": lambda: PAGE, "/package/airgs.json": growth.root}
    with serve({"web": WEB, "package": folder}, made) as site:
        seen = visit(f"{site.url}/page.html?{urlencode({'src': '/package/', 'check': 'live', 'back': 2})}")
    report = seen.report
    assert seen.complaints() == [] and report["unhandled"] == []
    assert report["problems"] == [] and report["error"] == 0
    joined = report["joined"]
    assert joined["live"] and first <= joined["duration"] < groups
    assert max(first, joined["duration"] - 1) - 1 <= joined["time"] < joined["duration"]  # one may have come since
    begin, back, again, newest = report["times"]
    assert (begin, back, again) == (0, 2, 2) and newest >= joined["duration"]
    assert joined["duration"] < report["grown"] <= groups
    assert report["duration"] == groups and not report["live"]
    assert report["currentTime"] == groups - 1 / FPS


def check_end(report, frames):
    stats = report["stats"]
    assert report["events"][-1] == "ended"
    assert stats["framesShown"] <= frames <= stats["framesShown"] + stats["framesDropped"]


def problems_of(report):
    """What is wrong on the page, and what was wrong with a server for a while."""
    passing = [one["message"] for one in report["problems"] if "trying again" in one["message"]]
    assert not any(one["fatal"] for one in report["problems"])
    return [one for one in report["problems"] if one["message"] not in passing], passing


def check_whole_pass(report, frames, waited=""):
    check_end(report, frames)
    problems, passing = problems_of(report)
    assert problems == [] and all(waited in words for words in passing) and bool(passing) == bool(waited)
    assert report["currentTime"] == pytest.approx((frames - 1) / FPS)


def test_over_a_link_that_falls_and_rises_again_rungs_follow(fox):
    folder = fox(20)
    report = look(folder, "once", link=trace((5, 2e6), (7, 7e4), (9, 2e6)), buffer=3)
    check_whole_pass(report, 20 * FPS)
    quality = [info["psnr"] for info in report["rungInfo"]]
    seen = [(one["atS"], quality[one["rung"]]) for one in report["looks"] if one["rung"] is not None]
    best = max(quality)
    slow = [q for at, q in seen if 7 < at < 12]
    assert min(slow) < best
    assert seen[0][1] and max(q for at, q in seen if at < 5) == best == seen[-1][1]


def wrong_once(path, number):
    return WRONG if number == 1 and path != "airgs.json" else None


@pytest.mark.parametrize(
    ("seconds", "fault", "more", "then"),
    [
        (8, outage("key/T0/6.bin", 3, SILENT), {"buffer": 3}, lambda report: report["given"] > 0),
        (
            6,
            outage("key/T0/4.bin", 3, 503),
            {"buffer": 1.5, "known": AWAY, "waited": "expected a file, got status 503"},
            lambda report: {"stall", "resume"} <= set(report["events"]),
        ),
        (
            6,
            lambda path, _: 404 if path.startswith("key/T0/Q0/") else None,
            {"known": AWAY},
            lambda report: all(name.startswith("Q1") for name in report["rungs"]),
        ),
        (4, wrong_once, {}, lambda report: report["asked"] >= {2}),
    ],
    ids=["an outage: given up", "busy: waited for", "no keys of a quality: not played", "wrong bytes: asked for again"],
)
def test_whatever_a_server_does_all_is_shown(fox, seconds, fault, more, then):
    moods, waited = Moods(fault), more.get("waited", "")
    report = look(fox(seconds), "once", moods, **{name: value for name, value in more.items() if name != "waited"})
    check_whole_pass(report, seconds * FPS, waited)
    assert then(report | {"asked": set(moods.asked.values())})


def test_a_server_that_is_away_is_waited_for(fox):
    report = look(fox(6), "away", known=AWAY)
    assert {"stall", "resume"} <= set(report["events"])
    check_whole_pass(report, 6 * FPS, "the server cannot be reached")


def test_a_state_that_stays_corrupt_is_lost_or_shown_in_another_rung(fox):
    bad = {f"state/L{level}/3.m4s": WRONG for level in range(2)} | {"state/L0/5.m4s": WRONG}
    report = look(fox(8), "once", Moods(lambda path, _: bad.get(path)))
    check_end(report, 8 * FPS)


def test_speed_and_loop_may_change_at_any_time(fox):
    report = look(fox(16), "speeds")
    for one in report["rates"]:
        assert abs(np.median(one["seen"]) - one["speed"]) < 0.4  # a late window is made up for by the next


def test_the_last_of_many_seeks_counts(fox):
    report = look(fox(12), "seeks")
    assert report["problems"] == []
    assert all(abs(one["time"] - one["wanted"]) < 1 for one in report["landed"])  # not where it played before
    assert report["last"] == report["wanted"]
    assert report["times"] == [0.5] and report["paused"]


def test_a_pause_and_a_seek_in_a_stall_hold(fox):
    report = look(fox(12), "stall", known=AWAY)
    assert problems_of(report)[0] == []
    assert report["sought"] == 6 and report["held"]


def test_of_a_player_that_was_closed_nothing_is_left(fox):
    report = look(fox(4), "close")
    assert report == {"errors": [], "unhandled": [], "workers": 0}


def test_of_two_packages_that_are_opened_at_once_the_last_one_counts(fox):
    other = GOLDEN / "fox-fine"
    folders = {"web": WEB, "package": fox(4), "other": other}
    with serve(folders, {"/page.html": lambda: PAGE}) as site:
        query = {"src": "/package/", "other": "/other/", "check": "reopen"}
        seen = visit(f"{site.url}/page.html?{urlencode(query)}")
    assert seen.complaints() == []
    report = seen.report
    assert report["opened"] == [float(open_package(other).manifest.fps), FPS]
    assert report["running"] > 0 and (report["workers"], report["unhandled"]) == (0, [])

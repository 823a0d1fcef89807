"""The player on a page under conditions as people have them: links, servers, growing packages, undecided viewers."""

import asyncio
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from urllib.parse import urlencode

import numpy as np
import pytest
from starlette.datastructures import MutableHeaders
from starlette.responses import Response

from tests.faces import Groups, open_package, pack_json, root_of
from tests.support.browser import WEB, build_pages, missing, serve, visit_all
from tests.support.page import script_page
from tests.support.paths import GOLDEN
from tests.support.repeated import write_repeated
from tests.support.servers import serving

WRONG = 0  # in the place of a status: the file with a wrong byte
SILENT = 1  # its headers, and no byte for as long as the answer to the next question is the same
LOOK_S = 0.02
CHUNK = 4096  # bytes
FPS = 2  # a group a second
AWAY = ("Failed to load resource", "ERR_")  # what browsers say of servers that are not there, and of what was given up
CORRUPT = ("delta/L0/3.m4s", "delta/L1/3.m4s", "delta/L0/5.m4s")

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"not here: {', '.join(missing())}")


def outage(trigger, seconds, status):
    """A fault of all answers for a while, from the first request for a file on."""
    begun = []

    def fault(path, _):
        if path == trigger and not begun:
            begun.append(time.monotonic())
        return status if begun and time.monotonic() < begun[0] + seconds else None

    return fault


def all_but_one_quality_is_wrong_once(path, number):
    if path.startswith("keyframe/T0/Q0/"):
        return 404
    return WRONG if number == 1 and path != "airgs.json" else None


@dataclass
class Case:
    """A check of web/test/pages/conditions.ts on a fox that walks for some seconds, and what happens to it."""

    check: str
    seconds: int
    fault: Callable[[str, int], int | None] = lambda *_: None  # path, number of the request -> status or these
    known: tuple[str, ...] = ()
    query: dict[str, object] = field(default_factory=dict)
    first: int = 0  # groups of a package that grows
    asked: Counter[str] = field(default_factory=Counter)  # paths below the package

    def open(self, stack, folder):
        """The address of the page, on servers that are there as long as `stack`."""
        if self.first or "other" in self.query:  # on the page's own server
            made = growing(folder, self.first) if self.first else {}
            folders, src = {"package": folder, "other": GOLDEN / "fox-fine"}, "/package/"
        else:
            server = stack.enter_context(Server(folder, self))
            folders, src = {}, f"http://127.0.0.1:{server.port}/{folder.name}/"
            made = {"/end": lambda: server.close() or b"ended", "/begin": server.begin}
            if self.check == "link":
                made = {"/end": partial(server.send_at, 7e4), "/begin": partial(server.send_at, 2e6)}
                server.send_at(2e6)
        site = stack.enter_context(serve({"web": WEB} | folders, made | {"/page.html": script_page("conditions")}))
        return f"{site.url}/page.html?{urlencode({'src': src, 'check': self.check, **self.query})}"


class Server(ExitStack):
    """A server that can be away and come back at the same port, none of whose answers a browser keeps."""

    def __init__(self, folder, case):
        super().__init__()
        self.folder, self.case, self.port, self.bit_s = folder, case, 0, np.inf
        self.begin()

    def begin(self):
        self.port = self.enter_context(serving(self.folder, port=self.port, around=self.around))
        return b"begun"

    def send_at(self, bit_s):
        self.bit_s = bit_s
        return b"sent"

    def around(self, app):
        async def moody(scope, receive, send):
            if scope["type"] != "http":
                await app(scope, receive, send)
                return
            path, asked = scope["path"].split("/", 2)[-1], self.case.asked
            asked[path] += 1
            fault = self.case.fault(path, asked[path])
            if fault not in (None, WRONG, SILENT):
                await Response("sorry", fault, {"Access-Control-Allow-Origin": "*"})(scope, receive, send)
                return

            async def send_on(message):
                if message["type"] == "http.response.start":
                    MutableHeaders(scope=message)["Cache-Control"] = "no-store"
                    await send(message)
                    return
                body = message.get("body", b"")
                if fault == WRONG and body:
                    body = bytes([body[0] ^ 1]) + body[1:]
                while self.case.fault(path, asked[path]) == SILENT:
                    await asyncio.sleep(LOOK_S)
                for start in range(0, len(body), CHUNK):
                    await asyncio.sleep(8 * CHUNK / self.bit_s)
                    await send({**message, "body": body[start : start + CHUNK], "more_body": True})
                await send({**message, "body": b""})

            await app(scope, receive, send_on)

        return moody


def growing(folder, first):
    """Answers: an airgs.json with a group more each second from /begin on, up to all that there are."""
    m, begun = open_package(folder).manifest, []

    def root():
        count = first + (int(time.monotonic() - begun[0]) if begun else 0)
        if count >= len(m.groups):
            return pack_json(root_of(m))
        groups = m.groups[:count]
        return pack_json(root_of(replace(m, live=True, frames=groups[-1].stop, groups=Groups.of(groups))))

    return {"/package/airgs.json": root, "/begin": lambda: begun.append(time.monotonic()) or b"begun"}


CASES = {  # the longest ones first
    "link": Case("link", 16),
    "speeds": Case("speeds", 16),
    "grows": Case("live", 10, query={"back": 2}, first=4),
    "away": Case("away", 4, known=AWAY),
    "outage": Case("once", 6, outage("keyframe/T0/4.bin", 3, SILENT), query={"buffer": 3}),
    "busy": Case("once", 4, outage("keyframe/T0/3.bin", 3, 503), known=AWAY, query={"buffer": 1.5}),
    "corrupt": Case("once", 6, lambda path, _: WRONG if path in CORRUPT else None),
    "wrong once": Case("once", 4, all_but_one_quality_is_wrong_once, known=AWAY),
    "seeks": Case("seeks", 12),
    "stall": Case("stall", 12, known=AWAY),
    "close": Case("close", 4, query={"other": "/other/"}),
}


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """A function from the name of a case to what the page reports of it."""
    build_pages()
    root, fox = tmp_path_factory.mktemp("fox"), open_package(GOLDEN / "fox")
    lengths = {case.seconds for case in CASES.values()}
    folders = {seconds: write_repeated(fox, root / f"{seconds}.airgs", seconds // 2, FPS) for seconds in lengths}
    with ExitStack() as stack:
        pages = [(case.open(stack, folders[case.seconds]), "") for case in CASES.values()]
        visits = dict(zip(CASES, visit_all(pages), strict=True))

    def get(name):
        seen = visits[name]
        assert seen.complaints(CASES[name].known) == []
        assert (seen.report["unhandled"], seen.report.get("error", 0)) == ([], 0)  # 0: of WebGL
        return seen.report

    return get


def problems_of(report):
    """What is wrong on the page, and what was wrong with a server for a while."""
    passing = [one["message"] for one in report["problems"] if "trying again" in one["message"]]
    assert not any(one["fatal"] for one in report["problems"])
    return [one for one in report["problems"] if one["message"] not in passing], passing


WAITED = {  # for what; None: something is wrong for good, and lost or shown in another rung
    "link": "", "outage": "", "busy": "expected a file, got status 503", "wrong once": "", "corrupt": None,
    "away": "the server cannot be reached",
}  # fmt: skip


@pytest.mark.parametrize("name", WAITED)
def test_whatever_a_server_does_all_is_shown(report, name):
    seen, frames, waited = report(name), CASES[name].seconds * FPS, WAITED[name]
    shown = seen["stats"]["framesShown"]
    assert seen["events"][-1] == "ended" and shown <= frames <= shown + seen["stats"]["framesDropped"]
    if waited is not None:
        problems, passing = problems_of(seen)
        assert (problems, [w for w in passing if waited not in w], bool(passing)) == ([], [], bool(waited))
        assert seen["currentTime"] == pytest.approx((frames - 1) / FPS)


def test_what_does_not_come_is_given_up(report):
    assert report("outage")["given"] > 0


def test_what_is_not_there_is_waited_for_or_asked_for_again(report):
    for name in ("busy", "away"):
        assert {"stall", "resume"} <= set(report(name)["events"])
    assert all(rung.startswith("Q1") for rung in report("wrong once")["rungs"])  # of Q0 there are no keys
    assert {*CASES["wrong once"].asked.values()} >= {2}


def test_over_a_link_that_falls_and_rises_again_rungs_follow(report):
    seen = report("link")
    assert seen["rungs"][0] == seen["rungs"][-1] != seen["fell"]


def test_a_growing_package_is_joined_at_its_newest_group_and_followed_to_its_end(report):
    seen, groups, first = report("grows"), CASES["grows"].seconds, CASES["grows"].first
    joined = seen["joined"]
    assert seen["problems"] == [] and joined["live"] and not seen["live"]
    assert first - 1 <= joined["time"] < first == joined["duration"]
    begin, back, again, newest = seen["times"]
    assert (begin, back, again) == (0, 2, 2) and newest >= first
    assert first < seen["grown"] <= groups == seen["duration"]
    assert seen["currentTime"] == groups - 1 / FPS


def test_speed_and_loop_may_change_at_any_time(report):
    for one in report("speeds")["rates"]:
        assert abs(np.median(one["seen"]) - one["speed"]) < 0.4  # a late window is made up for by the next


def test_the_last_of_many_seeks_counts_and_a_pause_and_a_seek_in_a_stall_hold(report):
    seen, stall = report("seeks"), report("stall")
    assert seen["problems"] == problems_of(stall)[0] == []
    assert all(abs(one["time"] - one["wanted"]) < 1 for one in seen["landed"])  # not where it played before
    assert seen["last"] == seen["wanted"]
    assert seen["times"] == [0.5] and seen["paused"]
    assert stall["sought"] == 6 and stall["held"]


def test_of_players_that_were_closed_nothing_is_left_and_of_packages_opened_at_once_the_last_one_counts(report):
    seen = report("close")
    running, opened = seen.pop("running"), [float(open_package(GOLDEN / "fox-fine").manifest.fps), FPS]
    assert seen == {"errors": [], "unhandled": [], "left": 0, "workers": 0, "opened": opened} and running > 0

"""The player over real HTTP on loopback: the same events, by the clock, also on bad days."""

import asyncio
import contextlib
import gzip
import shutil
import socket
import threading
import time
from dataclasses import replace
from functools import partial
from http.server import BaseHTTPRequestHandler, SimpleHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

from airgs_codec.places import place
from airgs_codec.play.downloader import Batch
from airgs_codec.play.http import LEAST_BYTES, FileClient, Transfer, connect, fetch_beside
from tests.faces import (
    JSON_NAME,
    AirgsError,
    BatchKind,
    ConfigError,
    FormatError,
    HttpDownloader,
    HttpSettings,
    Link,
    Request,
    SessionSettings,
    Trace,
    TransportError,
    check_repr_digest,
    format_metrics,
    open_package,
    play,
    repr_digest,
    simulate,
)
from tests.support.browser import Answer, serve
from tests.support.faulty import FAULTS, Weather, faultily_serving
from tests.support.paths import GOLDEN, VALID
from tests.support.servers import plainly_serving, serving
from tools.lab.bench.link import compare
from tools.lab.relay import shaped

PACKAGE = VALID / "two-groups-sh1"
RULES = SessionSettings(startup_s=0.0, resume_s=0.0, decode_frame_s=0.0, loops=1)
FAST = HttpSettings(as_fast=True, backoff_s=0.001)


def play_url(url, policy="fixed:0", rules=RULES, http=FAST, received=None):
    with HttpDownloader(url, http, received) as downloader:
        return play(downloader.open(), downloader, policy, rules)


def local(port, name=""):
    return f"http://127.0.0.1:{port}/{name}"


@pytest.fixture
def old_server():
    """HTTP/1.0, which closes the connection after every file; gives its URL."""
    handler = type("Handler", (SimpleHTTPRequestHandler,), {"log_message": lambda *_: None})
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(handler, directory=PACKAGE))
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
    yield local(server.server_address[1])
    server.shutdown()
    server.server_close()


def check_played_like_a_simulation(url):
    package, files = open_package(PACKAGE), {}
    log = play_url(url, received=files.__setitem__)
    simulated = simulate(package, Trace.open("const:100"), "fixed:0", RULES)
    assert [(f.kind, f.position, f.rung) for f in log.fetches] == [
        (f.kind, f.position, f.rung) for f in simulated.fetches
    ]
    assert log.bytes_by_kind == simulated.bytes_by_kind and not log.lost and not log.retried
    assert len(log.shown) == len(package.manifest.segments) and all(s.rung == 0 for s in log.shown)
    assert all(a.arrival_s <= b.arrival_s for a, b in zip(log.fetches, log.fetches[1:], strict=False))
    assert log.metrics.startup_requests == simulated.metrics.startup_requests
    assert files.pop(JSON_NAME) == (PACKAGE / JSON_NAME).read_bytes()
    assert files and all(data == package.read(path) for path, data in files.items())
    assert log.metrics.trace is None and log.metrics.utilisation is None
    assert "a real connection" in format_metrics(log)


def test_a_package_is_played_from_a_plain_web_server():
    with plainly_serving(PACKAGE) as port:
        check_played_like_a_simulation(local(port))


def test_a_server_may_end_every_connection(old_server):
    check_played_like_a_simulation(old_server)


def test_missing_and_altered_files_are_refused_as_they_come(tmp_path):
    package = open_package(PACKAGE)
    shutil.copytree(PACKAGE, tmp_path, dirs_exist_ok=True)
    state = package.manifest.state_files(0, 0)[0]
    (tmp_path / state).write_bytes(b"x" * package.manifest.entry(state).bytes)
    (tmp_path / package.manifest.key_files(1, 0, 0)[1]).unlink()  # the picture of one of two qualities
    with plainly_serving(tmp_path) as port:
        log = play_url(local(port))
    assert any(state in line and "SHA-256" in line for line in log.lost)
    assert sum(state in line for line in log.retried) == FAST.attempts - 1 == log.metrics.retries
    assert any("status 404" in line for line in log.lost)
    assert log.shown[0].rung is None and log.shown[-1].rung == 1  # one level; the other quality can be had
    assert 0 < log.metrics.wasted < 1 and "asked for again" in format_metrics(log)


def test_a_group_whose_table_cannot_be_had_is_lost(tmp_path):
    """The policy that looks ahead looks no further."""
    shutil.copytree(GOLDEN / "fox", tmp_path, dirs_exist_ok=True)
    (tmp_path / "group/2.json.gz").unlink()
    with plainly_serving(tmp_path) as port:
        log = play_url(local(port), "robust-mpc", replace(RULES, loops=2))
    assert [s.rung is None for s in log.shown] == [False, True] * 2


def test_a_link_that_falls_silent_is_given_up():
    """A server that answers with half a file, then says nothing."""
    package = open_package(PACKAGE)
    path = package.manifest.state_files(0, 0)[0]
    with faultily_serving(PACKAGE, Weather(share=0.0, stall_s=30.0)) as port, HttpDownloader(local(port)) as downloader:
        offers = downloader.open()
        tables = Batch(tables=("group/1.json.gz",))
        for _ in range(2):  # the first is airgs.json, which is there
            downloader.fetch(Request(BatchKind.TABLES, 0, 0, tables, 0.0, 0.0))
        looks = []

        def give_up(partial):
            looks.append(partial)
            return len(looks) == 2

        with faultily_serving(PACKAGE, Weather(1.0, {"stall": 1.0}, stall_s=30.0)) as silent:
            downloader._files = replace(downloader._files, url=local(silent))
            arrival = downloader.fetch(Request(BatchKind.STATE, 0, 0, Batch(state=(path,)), 0.0, 0.0), give_up)
    assert arrival.abandoned and not arrival.whole and not arrival.complete
    assert arrival.at_s - arrival.first_byte_s >= 2 * 0.5
    assert looks[0].elapsed_s >= 0.5 and looks[0].bytes < looks[0].expected_bytes
    assert looks[0].expected_bytes == offers.wire_bytes([offers.file_bytes(path)])


@contextlib.contextmanager
def answering(do_get):
    """A server whose GET is this function of the handler; gives its port."""
    handler = type("Handler", (BaseHTTPRequestHandler,), {"log_message": lambda *_: None, "do_GET": do_get})
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        yield server.server_address[1]
        server.shutdown()


def fetch_one(port, http):
    """What a client gets from a server for one file, and what it says of that."""
    taken, transfer = [], Transfer()

    async def get():
        async with connect(http, 1) as session:
            client = FileClient(session, local(port).rstrip("/"), http, lambda path, data: taken.append(data))
            await client.get("a.bin", 1 << 20, transfer, 0.0)

    try:
        asyncio.run(get())
    except TransportError as error:
        return taken, str(error)
    return taken, " ".join(str(error) for error in transfer.refused.values())


@pytest.mark.parametrize("form", ["http:{}/b.bin", "{}/b.bin", "https:{}/", "/b.bin"])
def test_a_redirect_stays_on_its_server(form):
    with serve({}, {"/b.bin": lambda: b"abc"}) as other:
        target = form.format(other.url.removeprefix("http:"))
        moved = Answer(status=302, headers={"Location": target})
        with serve({}, {"/a.bin": lambda: moved, "/b.bin": lambda: b"abc"}) as site:
            taken, refused = fetch_one(site.url.rpartition(":")[2], FAST)
    if form == "/b.bin":
        assert taken == [b"abc"] and not refused
    else:
        address = target.removesuffix("b.bin").rstrip("/")
        address = address if "://" in target else f"http:{address}"
        assert f"a.bin: expected a file of {site.url}, got a redirect to {address}" in refused
        assert not taken and not other.answers


@pytest.mark.parametrize("part", ["head", "body"])
def test_an_answer_that_trickles_is_broken_off_and_one_that_is_slow_is_not(part):
    """For twice the time-out a byte now and then, or enough of them."""
    size, http = 1 << 18, HttpSettings(timeout_s=1.0, attempts=1)
    head, body = f"HTTP/1.0 200 OK\r\nX: {'x' * 99}\r\nContent-Length: {size}\r\n\r\n".encode(), bytes(size)

    def answer(handler, step):
        start = 0 if part == "head" else len(head)
        stop = min(len(head), 40 * step) if part == "head" else start + 40 * step
        with contextlib.suppress(OSError):
            handler.wfile.write((head + body)[:start])
            for at in range(start, stop, step):
                handler.wfile.write((head + body)[at : min(at + step, stop)])
                time.sleep(0.05)
            handler.wfile.write((head + body)[stop:])

    with answering(lambda handler: answer(handler, 1)) as port:
        taken, refused = fetch_one(port, http)
    assert not taken and "the server is silent: fewer than 1024 bytes in 1 s" in refused
    with answering(lambda handler: answer(handler, LEAST_BYTES if part == "body" else 20)) as port:
        assert fetch_one(port, http) == ([body], "")


def test_links_that_fail_at_once_are_one_error():
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"http://127.0.0.1:{server.getsockname()[1]}"
    for read in READERS:
        with pytest.raises(TransportError, match=f"{url}/.*cannot be reached"):
            read(url)


def opened(url):
    with HttpDownloader(url, replace(FAST, timeout_s=0.3)) as downloader:
        downloader.open()


READERS = opened, open_package
ANSWERS = {  # for every file -> what is said of it, and how often the player asks
    "401": (Answer(status=401), "status 401 .the server asks for a sign-in", 1),
    "403": (Answer(status=403), "status 403 .the server refuses: a key", 1),
    "404": (Answer(status=404), "no such file|expected a package", 1),
    "416": (Answer(status=416), "status 416", 1),
    "429": (Answer(status=429, headers={"Retry-After": "9"}), "status 429 .the server is busy", 1),
    "page": (Answer(b"\n<!doctype html><p>app"), "expected JSON.*, got a web page", FAST.attempts),
    "circle": (Answer(status=302, headers={"Location": "airgs.json?a"}), "redirects lead in a circle", 10),
    "short": (Answer(b"{" * 99, lost=9), "airgs.json: broken off: the answer is shorter", FAST.attempts),
    "silent": (Answer(b"{" * 99, wait_s=20), "the server is silent", FAST.attempts),
}


@pytest.mark.parametrize("what", ANSWERS)
def test_whoever_reads_is_told_what_a_server_does(what, monkeypatch):
    monkeypatch.setattr(place, "SILENCE_S", 0.3)
    answer, words, asked = ANSWERS[what]
    with serve({}, {f"/p/{name}": lambda: answer for name in ("airgs.json", "manifest.mpd")}) as site:
        for read in READERS:
            with pytest.raises(AirgsError, match=words):
                read(f"{site.url}/p")
            assert read is open_package or len(site.answers) == asked


@pytest.mark.parametrize("form", ["", "/", "/airgs.json", "/manifest.mpd"])
def test_a_query_goes_with_every_file_and_tables_may_come_unpacked(form):
    """A signature letter by letter."""
    tables = {path: gzip.decompress((PACKAGE / path).read_bytes()) for path in ("group/1.json.gz", "group/2.json.gz")}
    query = "?sig=a%2Fb%2Bc%3D&x=%7Ey+z"
    with serve({"p": PACKAGE}, locked={"p": query}) as site:
        assert open_package(f"{site.url}/p{form}{query}").read("group/1.json.gz")
        with pytest.raises(TransportError, match="status 403"):
            open_package(f"{site.url}/p{form}?sig=no")
    with serve(
        {"p": PACKAGE}, {f"/p/{path}": lambda d=data: d for path, data in tables.items()}, locked={"p": query}
    ) as site:
        log = play_url(f"{site.url}/p{form}{query}")
        with pytest.raises(FormatError, match="got JSON that was unpacked"):
            open_package(f"{site.url}/p{form}{query}").read("group/1.json.gz")
    assert not log.lost and len(log.shown) == len(open_package(PACKAGE).manifest.segments)


@pytest.mark.parametrize("url", ["ftp://example.com/x", "http://", "http://a:b/", "http://[", "http://a/#x"])
def test_what_is_no_url_of_a_package_is_refused(url):
    with pytest.raises(ConfigError, match="http://"):
        HttpDownloader(url)


@pytest.mark.parametrize("wrong", [{"timeout_s": 0}, {"attempts": 0}, {"outage_s": -1}, {"backoff_s": float("nan")}])
def test_impatience_that_cannot_work_is_refused(wrong):
    with pytest.raises(ConfigError, match="expected"):
        HttpSettings(**wrong)


def test_waiting_for_room_takes_time_unless_as_fast(monkeypatch):
    rules, asked, sleep = replace(RULES, buffer_s=0.3, loops=None), [], asyncio.sleep
    monkeypatch.setattr(asyncio, "sleep", lambda seconds: asked.append(seconds) or sleep(seconds))
    with faultily_serving(PACKAGE, Weather(0.0)) as port:
        log = play_url(local(port), rules=rules)
        assert log.fetches[-1].arrival_s > log.metrics.played_s - 0.5 > sum(asked) == 0
        began_s = time.monotonic()
        real = play_url(local(port), rules=replace(rules, loops=8), http=HttpSettings())  # 1.3 s, fetched in less
        assert time.monotonic() - began_s >= real.fetches[-1].arrival_s > real.metrics.played_s - 0.5
    assert sum(asked) > 0


def test_a_thousand_faults_bring_no_wrong_file():
    """Of every kind, on files of every kind; what cannot be had is lost, never used."""
    package, weather = open_package(PACKAGE), Weather(0.6, dict.fromkeys(FAULTS, 1.0) | {"stall": 0.05}, stall_s=5.0)
    http = replace(FAST, timeout_s=0.1, outage_s=5.0)
    lost, retried, sessions = 0, 0, 0

    def check(path, data):
        assert data == (PACKAGE / path).read_bytes()

    with faultily_serving(PACKAGE, weather) as port:
        while weather.done.total() < 1000:
            sessions += 1
            try:
                log = play_url(local(port), "paper", replace(RULES, loops=20), http, check)
            except (FormatError, TransportError):
                continue  # not even airgs.json came
            assert len(log.shown) == 20 * len(package.manifest.segments)
            lost, retried = lost + len(log.lost), retried + len(log.retried)
    assert set(weather.done) == set(FAULTS) and retried > 500 and sessions > 1


def test_a_server_that_dies_and_comes_back_is_waited_for():
    """In the middle of a session; when it stays away, that is one error."""
    dead_s, impatient = 0.3, replace(FAST, backoff_s=0.02, outage_s=0.1)
    with contextlib.ExitStack() as stack:
        with faultily_serving(PACKAGE, Weather(0.0)) as port:
            patient = stack.enter_context(HttpDownloader(local(port), replace(impatient, outage_s=30.0)))
            hasty = stack.enter_context(HttpDownloader(local(port), impatient))
            offers = patient.open(), hasty.open()
        with pytest.raises(TransportError, match="cannot be reached"):
            play(offers[1], hasty, "fixed:0", RULES)
        back = threading.Timer(dead_s, lambda: stack.enter_context(faultily_serving(PACKAGE, Weather(0.0), port)))
        back.start()
        log = play(offers[0], patient, "fixed:0", RULES)
        back.join()
    assert not log.lost and all(shown.rung == 0 for shown in log.shown)
    assert any("cannot be reached" in line for line in log.retried) and log.shown[0].start_s >= dead_s


def test_what_pictures_show_beside_a_session_is_fetched_after_it():
    files = {}
    with plainly_serving(PACKAGE) as port, HttpDownloader(local(port), FAST, files.__setitem__) as downloader:
        log = play(downloader.open(), downloader, "fixed:Q1+L0", RULES)
        before = set(files)
        fetch_beside(log, downloader)
    assert {path.split("/")[-2] for path in set(files) - before} == {"Q0"}


def test_a_digest_in_the_headers_covers_airgs_json():
    check_repr_digest("airgs.json", b"abc", f"sha-512=:AAAA:, {repr_digest(b'abc')}")
    check_repr_digest("airgs.json", b"abc", "")
    with pytest.raises(FormatError, match="SHA-256"):
        check_repr_digest("airgs.json", b"abd", repr_digest(b"abc"))


def test_the_real_link_is_never_faster_than_the_simulated_one():
    """Part of a second of play; how close it comes is measured by tools/lab/bench/link.py, not here."""
    trace = Trace("t", np.array([0.0, 0.2, 0.4]), np.array([4e5, 0.0, 8e6]), 10.0)
    rules = SessionSettings(loops=1, pipelined=False, abandon=False, startup_s=0.0, buffer_s=2.0)
    with serving(PACKAGE) as server, shaped(server, trace, 0.02) as port:
        real = play_url(local(port, PACKAGE.name), rules=rules)
    simulated = simulate(real.offers, Link(trace, 0.02), "fixed:0", rules)
    assert compare(real, simulated)[0] == len(simulated.fetches) == len(real.fetches)
    assert all(a.arrival_s >= b.arrival_s - 0.005 for a, b in zip(real.fetches, simulated.fetches, strict=True))

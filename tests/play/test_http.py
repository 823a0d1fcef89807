"""The player over real HTTP on loopback: the same events, by the clock, also on bad days."""

import asyncio
import contextlib
import gzip
import shutil
import socket
import threading
import time
from dataclasses import replace
from datetime import timedelta
from functools import partial
from http.server import BaseHTTPRequestHandler

import numpy as np
import pytest

from tests import faces
from tests.faces import JSON_NAME, FormatError, HttpDownloader, HttpSettings, SessionSettings, open_package, play
from tests.support.browser import Answer, serve
from tests.support.faulty import FAULTS, Weather, faultily_serving
from tests.support.paths import GOLDEN, VALID
from tests.support.servers import answering, plainly_serving, serving
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


@pytest.mark.parametrize(("server", "name"), [
    (plainly_serving, ""), (serving, PACKAGE.name),
    (partial(plainly_serving, protocol="HTTP/1.0"), ""),  # every connection ends
])  # fmt: skip
def test_a_package_is_played_from_any_server_like_in_a_simulation(server, name):
    package, files = open_package(PACKAGE), {}
    with server(PACKAGE) as port:
        log = play_url(local(port, name), received=files.__setitem__)
    simulated = faces.simulate(package, faces.Trace.open("const:100"), "fixed:0", RULES)
    batches, expected = ([(f.kind, f.position, f.rung) for f in one.fetches] for one in (log, simulated))
    assert batches == expected
    assert log.bytes_by_kind == simulated.bytes_by_kind and not log.lost and not log.retried
    assert len(log.shown) == len(package.manifest.segments) and all(s.rung == 0 for s in log.shown)
    assert all(a.arrival_s <= b.arrival_s for a, b in zip(log.fetches, log.fetches[1:], strict=False))
    assert log.metrics.startup_requests == simulated.metrics.startup_requests
    assert files.pop(JSON_NAME) == (PACKAGE / JSON_NAME).read_bytes()
    assert files and all(data == package.read(path) for path, data in files.items())
    assert log.link is None and log.metrics.utilisation is None
    assert "a real connection" in faces.format_metrics(log)


def test_missing_and_altered_files_are_refused_as_they_come(tmp_path):
    package = open_package(PACKAGE)
    shutil.copytree(PACKAGE, tmp_path, dirs_exist_ok=True)
    delta = package.manifest.delta_files(0, 0)[0]
    (tmp_path / delta).write_bytes(b"x" * package.manifest.entry(delta).bytes)
    (tmp_path / package.manifest.keyframe_files(1, 0, 0)[1]).unlink()  # the picture of one of two qualities
    with plainly_serving(tmp_path) as port:
        log = play_url(local(port))
    assert any(delta in line and "SHA-256" in line for line in log.lost)
    assert sum(delta in line for line in log.retried) == FAST.attempts - 1 == log.metrics.retries
    assert any("status 404" in line for line in log.lost)
    assert log.shown[0].rung is None and log.shown[-1].rung == 1  # one level; the other quality can be had
    assert 0 < log.metrics.wasted < 1 and "asked for again" in faces.format_metrics(log)


def test_a_group_whose_table_cannot_be_had_is_lost(tmp_path):
    """The policy that looks ahead looks no further."""
    shutil.copytree(GOLDEN / "fox", tmp_path, dirs_exist_ok=True)
    (tmp_path / "group/2.json.gz").unlink()
    with plainly_serving(tmp_path) as port:
        log = play_url(local(port), "robust-mpc", replace(RULES, loops=2))
    assert [s.rung is None for s in log.shown] == [False, True] * 2


def test_a_link_that_falls_silent_is_given_up():
    """A server that sends all of a file but the last byte, then says nothing."""
    package = open_package(PACKAGE)
    path, looks = package.manifest.delta_files(0, 0)[0], []
    silent = {f"/p/{path}": lambda: Answer(package.read(path), wait_s=30)}

    def give_up(partial):
        looks.append(partial)
        return len(looks) == 2

    with serve({"p": PACKAGE}, silent) as site, HttpDownloader(f"{site.url}/p") as downloader:
        offers = downloader.open()
        tables, delta = faces.Batch(tables=("group/1.json.gz",)), faces.Batch(delta=(path,))
        downloader.fetch(faces.Request(faces.BatchKind.TABLES, 0, 0, tables, 0.0, 0.0))
        arrival = downloader.fetch(faces.Request(faces.BatchKind.DELTA, 0, 0, delta, 0.0, 0.0), give_up)
    assert arrival.abandoned and not arrival.whole and not arrival.complete
    assert arrival.at_s - arrival.first_byte_s >= 2 * 0.5
    assert looks[0].elapsed_s >= 0.5 and looks[0].bytes < looks[0].expected_bytes
    assert looks[0].expected_bytes == offers.wire_bytes([path])


def opened(url, timeout_s=0.3, attempts=FAST.attempts):
    with HttpDownloader(url, replace(FAST, timeout_s=timeout_s, attempts=attempts)) as downloader:
        downloader.open()


@pytest.mark.parametrize("part", ["head", "body"])
def test_an_answer_that_trickles_is_broken_off_and_one_that_is_slow_is_not(part):
    """For more than the time-out a byte now and then, or enough of them."""
    body = (PACKAGE / JSON_NAME).read_bytes().ljust(1 << 18)
    head = f"HTTP/1.0 200 OK\r\nX: {'x' * 99}\r\nContent-Length: {len(body)}\r\n\r\n".encode()

    def answer(handler, step):
        start, size = 0 if part == "head" else len(head), (40 if step == 1 else 25) * step
        stop = min(len(head), size) if part == "head" else start + size
        with contextlib.suppress(OSError):
            handler.wfile.write((head + body)[:start])
            for at in range(start, stop, step):
                handler.wfile.write((head + body)[at : min(at + step, stop)])
                time.sleep(0.05)
            handler.wfile.write((head + body)[stop:])

    def read(step):
        members = {"log_message": lambda *_: None, "do_GET": lambda handler: answer(handler, step)}
        with answering(type("Handler", (BaseHTTPRequestHandler,), members)) as port:
            opened(local(port), timeout_s=1.0, attempts=1)

    with pytest.raises(faces.AirgsError, match="the server is silent: fewer than 1024 bytes in 1 s"):
        read(1)
    read(1024 if part == "body" else 20)


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
REDIRECTS = {"scheme": "http:{}/b.bin", "host": "{}/b.bin", "root": "https:{}/", "same": "/p/airgs.json"}
QUERY = "?sig=a%2Fb%2Bc%3D&x=%7Ey+z"
TABLES = {path: gzip.decompress((PACKAGE / path).read_bytes()) for path in ("group/1.json.gz", "group/2.json.gz")}


@pytest.fixture(scope="module")
def other():
    with serve({}, {"/b.bin": lambda: b"abc"}) as site:
        yield site


@pytest.fixture(scope="module")
def site(other):
    """Packages: one, one behind a query, one whose tables are unpacked; and what servers say in place of one."""
    made = {f"/unpacked/{path}": partial(bytes, data) for path, data in TABLES.items()}
    for what, (answer, _, _) in ANSWERS.items():
        made |= {f"/{what}/{name}": partial(replace, answer) for name in (JSON_NAME, "manifest.mpd")}
    for what, form in REDIRECTS.items():
        target = form.format(other.url.removeprefix("http:"))
        made[f"/{what}/{JSON_NAME}"] = partial(Answer, status=302, headers={"Location": target})
    folders = dict.fromkeys(("p", "locked", "unpacked"), PACKAGE)
    with serve(folders, made, locked=dict.fromkeys(("locked", "unpacked"), QUERY)) as site:
        yield site


def test_a_redirect_stays_on_its_server(site, other):
    opened(f"{site.url}/same")
    for what, address in (("scheme", "http"), ("host", "http"), ("root", "https")):
        elsewhere = f"{address}:{other.url.removeprefix('http:')}"
        with pytest.raises(FormatError, match=f"expected a file of {site.url}, got a redirect to {elsewhere}"):
            opened(f"{site.url}/{what}")
    assert not other.answers


@pytest.fixture
def impatient(monkeypatch):
    monkeypatch.setattr("airgs_codec.places.place.SILENCE_S", 0.3)
    monkeypatch.setattr("airgs_codec.places.place._PATIENCE", {"retry_timeout": timedelta(seconds=0.2)})


@pytest.mark.parametrize("what", ANSWERS)
def test_whoever_reads_is_told_what_a_server_does(what, site, impatient):
    _, words, asked = ANSWERS[what]
    for read in READERS:
        before = len(site.answers)
        with pytest.raises(faces.AirgsError, match=words):
            read(f"{site.url}/{what}")
        assert read is open_package or len(site.answers) - before == asked


def test_links_that_fail_at_once_are_one_error(impatient):
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"http://127.0.0.1:{server.getsockname()[1]}"
    for read in READERS:
        with pytest.raises(faces.TransportError, match=f"{url}/.*cannot be reached"):
            read(url)


@pytest.mark.parametrize("form", ["", "/", "/airgs.json", "/manifest.mpd"])
def test_a_query_goes_with_every_file_and_unpacked_tables_are_refused(form, site):
    """A signature letter by letter."""
    assert open_package(f"{site.url}/locked{form}{QUERY}").read("group/1.json.gz")
    with pytest.raises(faces.TransportError, match="status 403"):
        open_package(f"{site.url}/locked{form}?sig=no")
    log = play_url(f"{site.url}/locked{form}{QUERY}")
    with pytest.raises(FormatError, match="got JSON that was unpacked"):
        open_package(f"{site.url}/unpacked{form}{QUERY}").read("group/1.json.gz")
    assert not log.lost and len(log.shown) == len(open_package(PACKAGE).manifest.segments)


@pytest.mark.parametrize(("make", "words"), [
    *((partial(HttpDownloader, url), "http://") for url in ("ftp://a/x", "http://", "http://a:b/", "http://[", "http://a/#x")),
    *((partial(HttpSettings, **given), "more than 0 s") for given in ({"timeout_s": 0}, {"backoff_s": np.nan})),
    *((partial(HttpSettings, **given), "expected an attempt or more") for given in ({"attempts": 0}, {"outage_s": -1})),
])  # fmt: skip
def test_addresses_of_nothing_and_impatience_that_cannot_work_are_refused(make, words):
    with pytest.raises(faces.ConfigError, match=words):
        make()


def test_waiting_for_room_takes_time_unless_as_fast(monkeypatch):
    rules, asked, sleep = replace(RULES, buffer_s=0.3, loops=40), [], asyncio.sleep
    monkeypatch.setattr(asyncio, "sleep", lambda seconds: asked.append(seconds) or sleep(seconds))
    with faultily_serving(PACKAGE, Weather(0.0)) as port:
        log = play_url(local(port), rules=rules)
        assert log.fetches[-1].arrival_s > log.metrics.played_s - 0.5 > sum(asked) == 0
        began_s = time.monotonic()
        real = play_url(local(port), rules=replace(rules, loops=6), http=HttpSettings())  # 1 s, fetched in less
        assert time.monotonic() - began_s >= real.fetches[-1].arrival_s > real.metrics.played_s - 0.5
    assert sum(asked) > 0


def test_a_thousand_faults_bring_no_wrong_file():
    """Of every kind, on files of every kind; what cannot be had is lost, never used."""
    package, weather = open_package(PACKAGE), Weather(0.6, dict.fromkeys(FAULTS, 1.0) | {"stall": 0.05}, stall_s=5.0)
    http, retried, sessions = replace(FAST, timeout_s=0.1, outage_s=5.0), 0, 0

    def check(path, data):
        assert data == (PACKAGE / path).read_bytes()

    with faultily_serving(PACKAGE, weather) as port:
        while weather.done.total() < 1000:
            sessions += 1
            try:
                log = play_url(local(port), "paper", replace(RULES, loops=20), http, check)
            except (FormatError, faces.TransportError):
                continue  # not even airgs.json came
            assert len(log.shown) == 20 * len(package.manifest.segments)
            retried += len(log.retried)
    assert set(weather.done) == set(FAULTS) and retried > 500 and sessions > 1


def test_a_server_that_dies_and_comes_back_is_waited_for():
    """In the middle of a session; when it stays away, that is one error."""
    dead_s, impatient = 0.3, replace(FAST, backoff_s=0.02, outage_s=0.1)
    with contextlib.ExitStack() as stack:
        with faultily_serving(PACKAGE, Weather(0.0)) as port:
            patient = stack.enter_context(HttpDownloader(local(port), replace(impatient, outage_s=30.0)))
            hasty = stack.enter_context(HttpDownloader(local(port), impatient))
            offers = patient.open(), hasty.open()
        with pytest.raises(faces.TransportError, match="cannot be reached"):
            play(offers[1], hasty, "fixed:0", RULES)
        back = threading.Timer(dead_s, lambda: stack.enter_context(faultily_serving(PACKAGE, Weather(0.0), port)))
        back.start()
        log = play(offers[0], patient, "fixed:0", RULES)
        back.join()
    assert not log.lost and all(shown.rung == 0 for shown in log.shown)
    assert any("cannot be reached" in line for line in log.retried) and log.shown[0].start_s >= dead_s


def test_a_digest_in_the_headers_covers_airgs_json():
    right = faces.repr_digest(b"abc")
    faces.check_repr_digest(JSON_NAME, b"abc", f"sha-512=:AAAA:, {right}")
    faces.check_repr_digest(JSON_NAME, b"abc", "")
    with pytest.raises(FormatError, match="SHA-256"):
        faces.check_repr_digest(JSON_NAME, b"abd", right)


def test_the_real_link_is_never_faster_than_the_simulated_one():
    """Part of a second of play; how close it comes is measured by tools/lab/bench/link.py, not here."""
    trace = faces.Trace("t", np.array([0.0, 0.2, 0.4]), np.array([4e5, 0.0, 8e6]), 10.0)
    rules = SessionSettings(loops=1, pipelined=False, abandon=False, startup_s=0.0, buffer_s=2.0)
    with serving(PACKAGE) as server, shaped(server, trace, 0.02) as port:
        real = play_url(local(port, PACKAGE.name), rules=rules)
    simulated = faces.simulate(real.offers, faces.Link(trace, 0.02), "fixed:0", rules)
    assert compare(real, simulated)[0] == len(simulated.fetches) == len(real.fetches)
    assert all(a.arrival_s >= b.arrival_s - 0.005 for a, b in zip(real.fetches, simulated.fetches, strict=True))

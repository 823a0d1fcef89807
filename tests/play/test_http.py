"""The player over real HTTP on loopback: the same events, by the clock."""

import socket
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

from airgs_codec.errors import ConfigError, TransportError
from airgs_codec.package.store import open_package
from airgs_codec.play.catalogue import Batch, Catalogue
from airgs_codec.play.events import BatchKind, Request
from airgs_codec.play.http import HttpDownloader, open_catalogue
from airgs_codec.play.http_responses import ResponseReader
from airgs_codec.play.link import Link
from airgs_codec.play.player import run
from airgs_codec.play.policies.named import make_policy
from airgs_codec.play.report.session import format_metrics
from airgs_codec.play.session import SessionLog, simulate
from airgs_codec.play.settings import SessionSettings
from airgs_codec.play.trace import Trace, open_trace
from tests.support.paths import VALID
from tools.check_link import ShapedServer, compare, play_really

PACKAGE = VALID / "two-groups-sh1"
RULES = SessionSettings(startup_s=0.0, resume_s=0.0, decode_frame_s=0.0, loops=1)


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, format, *args):
        pass


@pytest.fixture
def served():
    """Serves a folder with the standard library; gives its URL."""
    servers = []

    def serve(folder, version="HTTP/1.1", timeout=None):
        handler = type("Handler", (Quiet,), {"protocol_version": version, "timeout": timeout})
        servers.append(ThreadingHTTPServer(("127.0.0.1", 0), partial(handler, directory=folder)))
        servers[-1].daemon_threads = True
        threading.Thread(target=servers[-1].serve_forever, daemon=True).start()
        return f"http://127.0.0.1:{servers[-1].server_address[1]}"

    yield serve
    for server in servers:
        server.shutdown()
        server.server_close()


def play(url, policy="fixed:0", received=lambda path, data: None):
    catalogue = open_catalogue(url)
    downloader = HttpDownloader(url, catalogue, received)
    log = SessionLog.of(run(catalogue, downloader, make_policy(policy, catalogue), RULES), catalogue, policy, RULES)
    downloader.close()
    return log


@pytest.mark.parametrize("version", ["HTTP/1.1", "HTTP/1.0"])
def test_a_package_is_played_from_a_plain_web_server(served, version):
    """HTTP/1.0 closes the connection after every file: what is still to come is asked for again."""
    package, files = open_package(PACKAGE), {}
    log = play(served(PACKAGE, version), received=files.__setitem__)
    simulated = simulate(log.catalogue, open_trace("const:100"), "fixed:0", RULES)
    assert [(f.kind, f.position, f.rung) for f in log.fetches] == [
        (f.kind, f.position, f.rung) for f in simulated.fetches
    ]
    assert log.bytes_by_kind == simulated.bytes_by_kind and not log.lost
    assert len(log.shown) == len(package.manifest.segments) and all(s.rung == 0 for s in log.shown)
    assert all(a.arrival_s <= b.arrival_s for a, b in zip(log.fetches, log.fetches[1:], strict=False))
    del files["airgs.json"]
    assert files and all(data == package.read(path) for path, data in files.items())
    assert log.metrics.trace is None and log.metrics.utilisation is None
    assert "a real connection" in format_metrics(log)


def test_missing_and_altered_files_are_refused_as_they_come(served, tmp_path):
    package = open_package(PACKAGE)
    for path in ("airgs.json", *package.manifest.files()):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_bytes((PACKAGE / path).read_bytes())
    state = package.manifest.state_files(0, 0)[0]
    (tmp_path / state).write_bytes(b"x" * package.manifest.entry(state).bytes)
    (tmp_path / package.manifest.key_files(1, 0, 0)[1]).unlink()  # the picture of one of two qualities
    log = play(served(tmp_path))
    assert any(state in line and "SHA-256" in line for line in log.lost)
    assert any("status 404" in line for line in log.lost)
    assert log.shown[0].rung is None and log.shown[-1].rung == 1  # one level; the other quality can be had


def test_a_server_may_end_an_idle_connection(served):
    """A player whose buffer is full asks for nothing for a while."""
    catalogue = Catalogue(open_package(PACKAGE).manifest)
    downloader = HttpDownloader(served(PACKAGE, timeout=0.1), catalogue)
    batch = Batch(state=tuple(catalogue.manifest.state_files(0, 0)))
    for sent_s in (0.0, 0.5):
        arrival = downloader.fetch(Request(BatchKind.STATE, 0, 0, batch, sent_s, 0.0))
        assert arrival.complete and arrival.at_s >= arrival.first_byte_s >= sent_s
    downloader.close()


def test_a_link_that_falls_silent_is_given_up():
    """A server that answers with half a file, then says nothing."""
    catalogue = Catalogue(open_package(PACKAGE).manifest)
    batch = Batch(state=tuple(catalogue.manifest.state_files(0, 0)[:1]))
    size = catalogue.file_bytes(batch.files[0])
    with socket.create_server(("127.0.0.1", 0)) as server:
        downloader = HttpDownloader(f"http://127.0.0.1:{server.getsockname()[1]}", catalogue)
        answering = threading.Thread(target=_answer_half, args=(server, size))
        answering.start()
        looks = []

        def give_up(partial):
            looks.append(partial)
            return len(looks) == 2

        arrival = downloader.fetch(Request(BatchKind.STATE, 0, 0, batch, 0.0, 0.0), give_up)
        assert arrival.abandoned and not arrival.whole and not arrival.complete
        assert arrival.at_s - arrival.first_byte_s >= 2 * 0.5
        assert looks[0].elapsed_s >= 0.5 and size // 2 <= looks[0].bytes < looks[0].expected_bytes
        answering.join()  # it ends as the connection is closed


def _answer_half(server, size):
    connection, _ = server.accept()
    with connection:
        connection.recv(1 << 16)
        connection.sendall(f"HTTP/1.1 200 OK\r\nContent-Length: {size}\r\n\r\n".encode() + bytes(size // 2))
        connection.recv(1)  # until the client goes


def test_links_that_fail_are_one_error(served):
    catalogue = Catalogue(open_package(PACKAGE).manifest)
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"http://127.0.0.1:{server.getsockname()[1]}"
    request = Request(BatchKind.STATE, 0, 0, Batch(state=("state/L0/1.m4s",)), 0.0, 0.0)
    with pytest.raises(TransportError, match=url):
        HttpDownloader(url, catalogue).fetch(request)
    with pytest.raises(TransportError, match=r"airgs\.json"):
        open_catalogue(url)
    with pytest.raises(ConfigError, match="http://"):
        HttpDownloader("ftp://example.com/x", catalogue)


def test_responses_may_be_cut_anywhere():
    stream = b"".join(b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n" % n + bytes(range(n)) for n in (3, 0, 5))
    for step in (1, 2, 7, len(stream)):
        reader = ResponseReader(100)
        parts = [stream[i : i + step] for i in range(0, len(stream), step)]
        bodies = [bytes(r.body) for part in parts for r in reader.feed(part)]
        assert bodies == [bytes(range(3)), b"", bytes(range(5))]
    assert [(bytes(r.body), r.length) for r in ResponseReader(2).feed(stream)][2] == (bytes(range(2)), 5)


@pytest.mark.parametrize("head", [b"hello\r\n\r\n", b"HTTP/1.1 200 OK\r\n\r\n", b"x" * 70_000])
def test_what_is_no_response_is_refused(head):
    with pytest.raises(TransportError):
        list(ResponseReader(100).feed(head))


def test_the_real_link_is_never_faster_than_the_simulated_one():
    """Part of a second of play; how close it comes is measured by tools/check_link, not here."""
    link = Link(Trace("t", np.array([0.0, 0.2, 0.4]), np.array([4e5, 0.0, 8e6]), 10.0), 0.02)
    rules = SessionSettings(loops=1, pipelined=False, abandon=False, startup_s=0.0, buffer_s=2.0)
    server = ShapedServer(PACKAGE)
    real = play_really(server, link, "fixed:0", rules)
    server.close()
    simulated = simulate(real.catalogue, link, "fixed:0", rules)
    assert compare(real, simulated)[0] == len(simulated.fetches) == len(real.fetches)
    assert all(a.arrival_s >= b.arrival_s - 0.005 for a, b in zip(real.fetches, simulated.fetches, strict=True))

"""The real server on loopback: what viewers need, and what hostile clients get."""

import contextlib
import gzip
import http.client
import os
import re
import resource
import shutil
import signal
import socket
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue
from urllib.request import urlopen

import pytest

from tests import faces
from tests.faces import ConfigError, Folder, check_certificate, digest, listen
from tests.support.mutations import read_files
from tests.support.paths import VALID
from tests.support.scenes import moving_frames, write_sequence
from tests.support.servers import ask, say, serving

PACKAGE = VALID / "two-groups-sh1"
NAME = PACKAGE.name
ROOT = f"/{NAME}/airgs.json"
HEAD = {":method": "GET", ":path": ROOT, ":authority": "localhost"}  # of HTTP/2
PATIENCE_S = 0.4
DELTA, SIZE = "delta/L0/1.m4s", 32 << 20


@pytest.fixture(scope="module")
def port():
    with serving(PACKAGE, VALID / "moving", patience_s=PATIENCE_S) as port:
        yield port


@pytest.fixture
def big(tmp_path):
    """A package with a file that is larger than buffers are."""
    package = shutil.copytree(PACKAGE, tmp_path / "big")
    (package / DELTA).write_bytes(bytes(SIZE))
    return package


def statuses(answer):
    return [int(line.split()[1]) for line in answer.split(b"\r\n") if line.startswith(b"HTTP/1.1 ")]


def request(target=ROOT, method="GET", *lines):
    text = "\r\n".join([f"{method} {target} HTTP/1.1", "Host: a", *lines])
    return f"{text}\r\n\r\n".encode("latin-1")


def test_every_file_is_served_whole(port):
    for path, data in read_files(PACKAGE).items():
        status, headers, body = ask(port, f"/{NAME}/{path}")
        assert (status, body) == (200, data)
        assert headers["Content-Type"] == faces.media_type(path) and headers["Content-Length"] == str(len(data))
        assert ("immutable" in headers["Cache-Control"]) == (path not in ("airgs.json", "manifest.mpd"))
        assert headers["Access-Control-Allow-Origin"] == "*" and headers["X-Content-Type-Options"] == "nosniff"
        status, headers, body = ask(port, f"/{NAME}/{path}", "HEAD")
        assert (status, body, headers["Content-Length"]) == (200, b"", str(len(data)))


def test_packages_are_listed_in_the_order_of_their_names_and_their_folders_lead_to_the_player(port):
    page = ask(port, "/")[2].decode()
    assert 0 < page.index("/moving/manifest.mpd") < page.index(f"/{NAME}/manifest.mpd")
    status, headers, _ = ask(port, f"/{NAME}/")
    assert (status, headers["Location"]) == (307, f"../player.html?src={NAME}/")


def test_conditions_and_ranges(port):
    data, target = (PACKAGE / DELTA).read_bytes(), f"/{NAME}/{DELTA}"
    tag = ask(port, target)[1]["ETag"]
    for known in (tag, f'"a", W/{tag}', "*"):
        status, headers, body = ask(port, target, If_None_Match=known)
        assert (status, body) == (304, b"") and "immutable" in headers["Cache-Control"]
    status, headers, body = ask(port, target, Range="bytes=5-9", If_Range=tag)
    assert (status, body, headers["Content-Range"]) == (206, data[5:10], f"bytes 5-9/{len(data)}")
    assert headers["Content-Type"] == "video/mp4" and "immutable" in headers["Cache-Control"]
    assert ask(port, target, Range="bytes=5-9", If_Range='"old"')[0::2] == (200, data)
    assert ask(port, target, Range="bytes=-5")[0::2] == (206, data[-5:])
    assert ask(port, target, Range=f"bytes={10**30}-")[0] == 416
    for text in ("bytes=5-4", "bytes=a-b", "bytes=", "bits=0-1", f"bytes={'9' * 9000}-", "bytes=--1", "bytes=-0", "x"):
        assert ask(port, target, Range=text)[0] in (200, 400, 416), text
    many = ",".join(f"{i}-{i}" for i in range(1000))
    assert ask(port, target, Range=f"bytes={many}")[0::2] == (200, data)


def test_texts_are_zipped_for_those_who_take_it_and_never_given_in_parts(port):
    data = (PACKAGE / "airgs.json").read_bytes()
    for accepted in ("br, gzip", "br"):
        status, headers, body = ask(port, ROOT, Accept_Encoding=accepted, Range="bytes=0-9")
        zipped = headers["Content-Encoding"] == "gzip"
        assert status == 200 and zipped == ("gzip" in accepted)
        assert (gzip.decompress(body) if zipped else body) == data
        assert headers["ETag"] == f'"{digest(data)}{"-gzip" * zipped}"' and headers["Vary"] == "Accept-Encoding"
        faces.check_repr_digest("airgs.json", body, headers["Repr-Digest"])
        assert ask(port, ROOT, Accept_Encoding=accepted, If_None_Match=headers["ETag"])[0::2] == (304, b"")


def test_pages_of_other_origins_may_ask_for_ranges_and_read_tags(port):
    asked = {"Origin": "https://a.b", "Access-Control-Request-Method": "GET", "Access-Control-Request-Headers": "range"}
    status, headers, _ = ask(port, ROOT, "OPTIONS", **asked)
    assert status == 204 and "Range" in headers["Access-Control-Allow-Headers"]
    assert headers["Access-Control-Allow-Origin"] == "*" and "GET" in headers["Access-Control-Allow-Methods"]
    assert ask(port, ROOT)[1]["Access-Control-Expose-Headers"] == "*"  # ETag and Content-Range, too
    assert ask(port, "/nothing")[1]["Access-Control-Allow-Origin"] == "*"


@pytest.mark.parametrize("target", [
    *("/../../etc/passwd", "/%ff%fe/airgs.json", "/other/airgs.json", "/other/", f"/{NAME}", "*"),
    *(f"/{NAME}/{to}" for to in ("../moving/airgs.json", "%2e%2e/moving/airgs.json", "..%2fmoving%2fairgs.json")),
    *(f"/{NAME}/{path}" for path in ("/etc/passwd", "keyframe/..%5c..%5cairgs.json", ".airgs.json.part", "key")),
    f"/{NAME}/airgs.json%00.m4s",
])  # fmt: skip
def test_nothing_else_is_served(port, target):
    assert statuses(say(port, request(target, "GET", "Connection: close"))) == [404]


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "TRACE", "NONSENSE"])
def test_other_methods_are_refused(port, method):
    status, headers, _ = ask(port, ROOT, method, Content_Length="0")
    assert status == 405 and set(headers["Allow"].split(", ")) == {"GET", "HEAD", "OPTIONS"}


@pytest.mark.parametrize(("data", "status"), [
    (request(ROOT, "POST", "Content-Length: 9999999") + b"x" * 100, 405),
    (request(ROOT, "GET", "Content-Length: 9999999"), 413),
    (request(ROOT, "GET", "Transfer-Encoding: chunked") + b"5\r\nhello\r\n", 413),
    (request(ROOT, "GET", "Content-Length: -1"), 400),
    (request(ROOT, "GET", "Content-Length: 0", "Content-Length: 7"), 400),
    (request(ROOT, "GET", f"X: {'x' * 20_000}"), 431),
    (request(ROOT, "GET", *(f"X{i}: x" for i in range(4000))), 431),
    (request(f"/{'x' * 20_000}"), 431),
    (b"GET / HTTP/1.1\r\nHost: a\r\n" + b"X: x\r\n" * 50_000, 431),
    (b"GET / HTTP/1.1\r\n\r\n", 400), (b"GET /\xff HTTP/1.1\r\nHost: a\r\n\r\n", 400),
    (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n", 400),
])  # fmt: skip
def test_bodies_huge_headers_and_nonsense_are_refused_and_end_the_connection(port, data, status):
    """What follows a refused body must not be taken for a request."""
    try:
        assert statuses(say(port, data)) == [status]
    except ConnectionResetError:  # the server did not read all of it
        assert len(data) > 16_384
    assert ask(port, ROOT)[0] == 200


@pytest.mark.parametrize("data", [b"", b"G", request()[:-2], b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"])
def test_a_client_that_does_not_finish_its_request_is_sent_away(port, data):
    answer = say(port, data)  # ends, or raises TimeoutError
    assert b"HTTP/1.1 200" not in answer


def test_a_byte_now_and_then_does_not_buy_time(port):
    """Slow loris: headers that trickle in for ever."""
    step_s = PATIENCE_S / 8
    with socket.create_connection(("127.0.0.1", port), step_s) as connection, contextlib.suppress(ConnectionError):
        connection.sendall(b"GET / HTTP/1.1\r\nHost: a\r\n")
        for _ in range(round(10 / step_s)):
            connection.sendall(b"X: x\r\n")
            with contextlib.suppress(TimeoutError):
                assert connection.recv(1) == b""
                return
        pytest.fail("it is still connected after ten seconds")


@pytest.mark.skipif(not hasattr(socket, "TCP_USER_TIMEOUT"), reason="the kernel does it")
def test_a_client_that_takes_nothing_is_dropped(big):
    with (
        serving(big, patience_s=PATIENCE_S, grace_s=0.1) as port,
        socket.socket() as connection,
    ):
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 16)
        connection.settimeout(10)
        connection.connect(("127.0.0.1", port))
        connection.sendall(request(f"/big/{DELTA}"))
        threading.Event().wait(8 * PATIENCE_S)
        taken = 0
        with contextlib.suppress(ConnectionError):
            while part := connection.recv(1 << 20):
                taken += len(part)
        assert taken < SIZE


@pytest.mark.parametrize("truncated", [False, True])
def test_nobody_is_given_parts_of_two_files_for_one(big, truncated):
    """A file that is replaced while it is sent comes as it was; of one that is cut the answer ends before its end."""
    with serving(big) as port:
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
        connection.request("GET", f"/big/{DELTA}")
        response = connection.getresponse()
        if truncated:
            os.truncate(big / DELTA, 0)
            with pytest.raises(http.client.IncompleteRead):
                response.read()
        else:
            Folder(big).write(DELTA, b"x" * SIZE)
            assert response.read() == bytes(SIZE)
        connection.close()


def test_memory_does_not_grow_with_files_that_nobody_takes(big):
    """Clients that read nothing of a large file, and one that wants a byte of it, from a server with 256 MiB more."""
    os.truncate(big / DELTA, 100 << 20)
    program = [sys.executable, "-uc", "from airgs_codec.cli.serve import main; main()", str(big), "--port", "0"]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as child, contextlib.ExitStack() as stack:
        stack.callback(child.terminate)
        port = next(int(found[1]) for line in child.stdout if (found := re.search(r"http://[^/]*:(\d+)", line)))
        taken = int(re.search(r"VmData:\s+(\d+)", Path(f"/proc/{child.pid}/status").read_text())[1]) << 10
        resource.prlimit(child.pid, resource.RLIMIT_DATA, (taken + (256 << 20),) * 2)
        for _ in range(40):
            reader = stack.enter_context(socket.create_connection(("127.0.0.1", port)))
            reader.sendall(request(f"/big/{DELTA}"))
            assert reader.recv(12) == b"HTTP/1.1 200"
        status, _, body = ask(port, f"/big/{DELTA}", Range="bytes=77777-77777")
        assert (status, len(body), child.poll()) == (206, 1, None)


def test_a_growing_package_is_never_served_in_parts_of_two_versions(tmp_path):
    """Its root is replaced again and again while many read it."""
    package = shutil.copytree(PACKAGE, tmp_path / "live")
    versions = {f'"{digest(data)}"': data for data in (b"%d" % i * 40_000 for i in range(10))}
    with serving(package) as port, ThreadPoolExecutor(8) as pool:
        Folder(package).write("airgs.json", next(iter(versions.values())))
        answers = [pool.submit(ask, port, "/live/airgs.json") for _ in range(100)]
        for data in versions.values():
            Folder(package).write("airgs.json", data)
            assert ask(port, "/live/airgs.json")[2] == data
        for answer in answers:
            status, headers, body = answer.result()
            assert status == 200 and versions[headers["ETag"]] == body


def test_answers_to_pipelined_requests_come_in_their_order(port):
    paths = sorted(read_files(PACKAGE)) * 20
    requests = [request(f"/{NAME}/{path}") for path in paths]
    answer = say(port, b"".join(requests) + request("/", "GET", "Connection: close"))
    at = 0
    for path in paths:
        data = (PACKAGE / path).read_bytes()
        assert f"content-length: {len(data)}".encode() in answer[at:].split(b"\r\n\r\n", 1)[0]
        at = answer.index(b"\r\n\r\n", at) + 4
        assert answer[at : at + len(data)] == data
        at += len(data)


def test_an_open_connection_does_not_keep_the_server_from_stopping():
    with serving(PACKAGE) as port:
        idle = socket.create_connection(("127.0.0.1", port), 10)
        idle.sendall(request())
        assert idle.recv(12) == b"HTTP/1.1 200"
    while idle.recv(1 << 16):  # to the end
        pass
    idle.close()


def test_who_listens_does_not_wait_for_acknowledgements_and_needs_a_port_that_is_free(port):
    """Nagle's algorithm would hold pieces of an answer back for 40 ms; connections inherit the option."""
    with listen("127.0.0.1", 0) as listening:
        assert listening.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
    for host, number in (("127.0.0.1", port), ("no host", 0), ("127.0.0.1", 1 << 16), ("127.0.0.1", -1)):
        with pytest.raises(ConfigError, match="expected"):
            listen(host, number)


def test_a_client_that_takes_its_requests_back_is_no_news(port, caplog):
    """HTTP/2's rapid reset: more streams at once than there may be."""
    client = pytest.importorskip("h2.connection").H2Connection()
    client.initiate_connection()
    for stream in range(1, 2400, 2):
        client.send_headers(stream, [*HEAD.items(), (":scheme", "http")], end_stream=True)
        client.reset_stream(stream)
    with contextlib.suppress(ConnectionError):
        say(port, client.data_to_send())
    assert ask(port, ROOT)[0] == 200 and caplog.records == []


@pytest.mark.skipif(not shutil.which("openssl"), reason="needs openssl to make a certificate")
def test_https_speaks_http_2(tmp_path):
    h2 = pytest.importorskip("h2.connection")
    import ssl

    from h2.events import DataReceived, StreamEnded

    chain, key = tmp_path / "chain.pem", tmp_path / "key.pem"
    made = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes"]
    subject = ["-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost"]
    subprocess.run([*made, *subject, "-keyout", key, "-out", chain], check=True, capture_output=True)
    with pytest.raises(ConfigError, match="PEM"):
        check_certificate(key, chain)
    check_certificate(chain, key)
    context = ssl.create_default_context(cafile=chain)
    context.set_alpn_protocols(["h2"])
    with (
        serving(PACKAGE, certificate=(chain, key)) as port,
        socket.create_connection(("127.0.0.1", port), 10) as plain,
        context.wrap_socket(plain, server_hostname="localhost") as connection,
    ):
        assert connection.selected_alpn_protocol() == "h2"
        client, data, ended = h2.H2Connection(), b"", False
        client.initiate_connection()
        client.send_headers(1, [*HEAD.items(), (":scheme", "https")], end_stream=True)
        while not ended:
            connection.sendall(client.data_to_send())
            for event in client.receive_data(connection.recv(1 << 16)):
                data += event.data if isinstance(event, DataReceived) else b""
                ended |= isinstance(event, StreamEnded)
    assert data == (PACKAGE / "airgs.json").read_bytes()


def drop(port, name, data, **headers):
    """Post a file as the page of a server does."""
    return ask(port, f"/?name={name}", "POST", data, **{"Origin": f"http://127.0.0.1:{port}"} | headers)


def test_a_file_that_is_dropped_becomes_a_package_whose_guesses_are_said_and_a_bad_one_a_line(tmp_path):
    scene = write_sequence(tmp_path / "a", moving_frames(60, 1), cameras=False)
    home, said = tmp_path / "home", SimpleQueue()
    home.mkdir()
    with serving(home=home, say=said.put) as port:
        good = next(scene.iterdir()).read_bytes()
        for sent, name, data in (("..%2F..%2F", "bad", b"no splats"), ("C%3A%5Cx%5C", "a", good)):
            status, headers, _ = drop(port, f"{sent}{name}.ply", data)
            assert (status, headers["Location"]) == (202, f"/player.html?src={name}.airgs/")
        lines = [said.get(timeout=300)]
        while not lines[-1].endswith("a.airgs: encoded"):
            lines.append(said.get(timeout=300))
        page = ask(port, "/")[2].decode()
        assert "/player.html?src=a.airgs/" in page and ask(port, "/a.airgs/airgs.json")[0] == 200
    assert "<p role=alert><b>bad</b>: bad.ply: expected" in page and str(tmp_path) not in page
    assert "<b>a</b>: cannot tell up" in page or "<b>a</b>: up is guessed" in page
    assert any(line.startswith("a.airgs: ") and " up" in line for line in lines)
    assert [path.name for path in home.iterdir()] == ["a.airgs"]


@pytest.mark.parametrize(("name", "headers", "status"), [
    ("a.ply", {"Origin": "https://evil.example"}, 403), ("a.ply", {"Origin": "null"}, 403),
    ("a.ply", {"Origin": "http://localhost:1"}, 403),
    ("a.ply", {"Origin": "http://evil.example", "Host": "evil.example"}, 403),  # whose DNS leads here
    ("a.ply", {"Content_Length": str(1 << 40)}, 413), ("a.ply", {"Transfer_Encoding": "chunked"}, 413),
    ("..", {}, 400), (".bashrc", {}, 400), ("a%00.ply", {}, 400), ("", {}, 400), ("x" * 300, {}, 400),
])  # fmt: skip
def test_files_that_are_not_from_the_own_page_too_large_or_badly_named_are_refused(tmp_path, name, headers, status):
    with serving(home=tmp_path) as port:
        answer = drop(port, name, b"", **headers)
        assert answer[0] == status and answer[2].decode().count("\n") == 1
        assert ask(port, "/")[0] == 200
    assert not list(tmp_path.iterdir())


def test_a_server_that_takes_no_files_says_so(port, tmp_path):
    with serving(home=tmp_path, dropping=False) as encoding:
        for one in (port, encoding):
            status, _, body = drop(one, "a.ply", b"ply")
            assert status == 403 and b"--drop" in body and b'type="file"' not in ask(one, "/")[2]


def test_a_disk_that_is_full_is_a_line_and_nothing_stays(tmp_path, monkeypatch):
    with serving(home=tmp_path) as port:
        full = lambda *_: os.fdopen(os.open("/dev/full", os.O_WRONLY), "wb", 0)  # noqa: E731
        monkeypatch.setattr("airgs_codec.serve.scenes.open", full, raising=False)
        for size in (3, 1 << 20):  # in one part, and in many
            assert drop(port, "a.ply", bytes(size))[::2] == (400, b"No space left on device\n")
    assert not list(tmp_path.iterdir())


def test_a_folder_of_frames_is_encoded_and_nothing_of_it_is_left_where_the_server_is_ended(tmp_path):
    scene, home = write_sequence(tmp_path / "moves", moving_frames(60, 2)), tmp_path / "tmp"
    home.mkdir()
    program = [sys.executable, "-uc", "from airgs_codec.cli.serve import main; raise SystemExit(main())"]
    pipes = dict.fromkeys(("stdout", "stderr"), subprocess.PIPE)
    how = pipes | {"text": True, "env": os.environ | {"TMPDIR": str(home)}}
    for number, heard in ((signal.SIGTERM, "encoded"), (signal.SIGINT, "scenes become")):
        with subprocess.Popen([*program, str(scene), "--port", "0"], **how) as child, contextlib.ExitStack() as stack:
            stack.callback(child.kill)
            port = int(re.search(r":(\d+)", child.stdout.readline())[1])
            assert any(heard in line for line in child.stderr)
            assert (b"/moves.airgs/airgs.json" in ask(port, "/")[2]) == (heard == "encoded")
            child.send_signal(number)
            assert child.wait(100) == 0
        assert not list(home.iterdir())


def test_open_shows_the_player_of_one_package_in_a_browser(monkeypatch):
    opened = []

    def browse(page):
        opened.append((page, urlopen(page).status))
        os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr("webbrowser.open", browse)
    assert faces.airgs_serve([str(PACKAGE), "--port", "0", "--open"]) == 0
    [(page, status)] = opened
    assert status == 200 and page.endswith(f"/player.html?src={NAME}/")

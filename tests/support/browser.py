"""A real browser for tests: a static server of folders, and pages opened by headless Chromium (web/test/open.mjs)."""

from __future__ import annotations

import atexit
import fcntl
import json
import os
import shutil
import socket
import subprocess
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from http.server import SimpleHTTPRequestHandler
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from tests.support.paths import REPOSITORY
from tests.support.servers import answering

WEB = REPOSITORY / "web"
CHROMIUMS = ("chromium", "chromium-browser", "google-chrome")
CHROMIUM = next(filter(None, map(shutil.which, ("chromium-headless-shell", *CHROMIUMS))), None)  # without windows first
LEAST_NODE = 20
OWN = "GPU stall due to ReadPixels"  # Chromium says so of every WebGL canvas where no GPU puts pages together
TYPES = {".mjs": "text/javascript", ".mpd": "application/dash+xml", ".m4s": "video/iso.segment", ".mp4": "video/mp4"}


@cache
def missing() -> tuple[str, ...]:
    """What a test in the browser needs and this machine lacks."""
    node = shutil.which("node")
    version = subprocess.run([node, "--version"], capture_output=True, text=True, check=True).stdout if node else "v0"
    found = {
        f"node {LEAST_NODE} or newer": int(version.strip().removeprefix("v").split(".")[0]) >= LEAST_NODE,
        "chromium": CHROMIUM is not None,
        "packages (npm ci --prefix web)": (WEB / "node_modules" / "playwright-core").is_dir(),
    }
    return tuple(what for what, there in found.items() if not there)


@dataclass(frozen=True)
class Site:
    """A running server of folders, and what was asked of it."""

    url: str  # without a slash at the end
    answers: list[tuple[str, int]]  # path and status of every answer, in order


@dataclass(frozen=True)
class Answer:
    body: bytes = b""
    status: int = 200
    headers: Mapping[str, str] = field(default_factory=dict)
    lost: int = 0  # bytes at the end of the body that never come: the connection ends before them
    wait_s: float = 0.0  # before the last byte that comes
    dropped: bool = False  # nothing comes at all: the connection ends


Made = bytes | Answer | Callable[[], bytes | Answer | None]  # made anew for each request; None: the file as it is


@contextmanager
def serve(
    folders: Mapping[str, Path],
    made: Mapping[str, Made] | None = None,
    told: Callable[[bytes], bytes] | None = None,
    locked: Mapping[str, str] | None = None,
) -> Iterator[Site]:
    """Python's own static server.

    `folders` are the first parts of paths, and what lies below them; `made` are the answers of paths; `told` takes what
    is posted, and answers; `locked` are queries without which a folder is forbidden.
    """
    answers: list[tuple[str, int]] = []
    ended = threading.Event()

    class Handler(SimpleHTTPRequestHandler):
        extensions_map = SimpleHTTPRequestHandler.extensions_map | TYPES

        def do_GET(self) -> None:
            given = (made or {}).get(urlsplit(self.path).path)
            key = (locked or {}).get(self.path.split("/")[1], "")
            answer = Answer(status=403) if not self.path.endswith(key) else given() if callable(given) else given
            if answer is None:
                super().do_GET()
            else:
                self._give(answer if isinstance(answer, Answer) else Answer(answer))

        def do_POST(self) -> None:
            assert told
            self._give(Answer(told(self.rfile.read(int(self.headers["Content-Length"])))))

        def _give(self, answer: Answer) -> None:
            if answer.dropped:
                self.log_request(0)
                self.connection.shutdown(socket.SHUT_RDWR)
                return
            self.send_response(answer.status)
            usual = {"Content-Type": self.guess_type(urlsplit(self.path).path), "Content-Length": len(answer.body)}
            for name, value in (usual | dict(answer.headers)).items():
                self.send_header(name, str(value))
            self.end_headers()
            come = answer.body[: len(answer.body) - answer.lost]
            with suppress(OSError):  # nobody waited for it
                self.wfile.write(come[:-1])
                ended.wait(answer.wait_s)
                self.wfile.write(come[-1:])

        def translate_path(self, path: str) -> str:
            first, _, rest = unquote(urlsplit(path).path).lstrip("/").partition("/")
            return str(folders[first] / rest) if first in folders and ".." not in rest else os.devnull + "/"

        def log_request(self, code: int | str = "-", size: int | str = "-") -> None:
            answers.append((urlsplit(self.path).path, int(code)))

        def log_message(self, format: str, *args: object) -> None:
            """Nothing is printed."""

    with answering(Handler) as port:
        try:
            yield Site(f"http://127.0.0.1:{port}", answers)
        finally:
            ended.set()


@cache
def build_pages(which: str = "pages") -> None:
    """Bundle what web/scripts/WHICH.mjs does into web/out/WHICH; processes that want it at the same time take turns."""
    folder = WEB / "out" / which
    folder.mkdir(parents=True, exist_ok=True)
    with (WEB / "out" / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        parts = ("src", "adapters", "test", "scripts", "examples")
        sources = [*WEB.glob("*.*"), *(path for part in parts for path in (WEB / part).rglob("*.*"))]
        built = [path.stat().st_mtime for path in folder.rglob("*.js")]
        if not built or min(built) < max(path.stat().st_mtime for path in sources):
            subprocess.run(["node", f"scripts/{which}.mjs"], cwd=WEB, check=True)


@dataclass(frozen=True)
class Visit:
    report: Any  # what its promise `window.report` gave
    messages: list[dict[str, str]]  # type and text of each line of its console
    failed: list[str]  # errors that nothing caught

    def complaints(self, known: tuple[str, ...] = ()) -> list[str]:
        """Errors, and errors and warnings of the console, without a `known` part or what the browser brings along."""
        said = [message["text"] for message in self.messages if message["type"] in ("error", "warning")]
        return [text for text in (*self.failed, *said) if not any(part in text for part in (OWN, *known))]


@cache
def _opener() -> subprocess.Popen[bytes]:
    """The Chromium of this process: some pages are open at once, each without anything of the others."""
    environment = os.environ | {"CHROMIUM": str(CHROMIUM)}
    command = ["node", str(WEB / "test" / "open.mjs")]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment)
    atexit.register(process.communicate)  # it ends with its input
    return process


def visit_all(pages: Sequence[tuple[str, str]]) -> list[Visit]:
    """Open pages, some at once, each with a script that runs before its own ("": none), and wait for their reports."""
    process = _opener()
    assert process.stdin and process.stdout
    for number, (url, script) in enumerate(pages):
        process.stdin.write(json.dumps({"number": number, "url": url, "script": script or None}).encode() + b"\n")
    process.stdin.flush()
    seen: dict[int, Visit] = {}
    while len(seen) < len(pages):
        line = process.stdout.readline()  # it gives up by itself where a page does not report
        assert line, f"the browser ended with status {process.wait()}"
        came = json.loads(line)
        number = came.pop("number")
        seen[number] = Visit(**came)
    return [seen[number] for number in range(len(pages))]


def visit(url: str, script: str = "") -> Visit:
    return visit_all([(url, script)])[0]

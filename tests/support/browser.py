"""A real browser for tests: a static server of folders, and pages opened by headless Chromium (web/test/open.mjs)."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from tests.support.paths import REPOSITORY

WEB = REPOSITORY / "web"
CHROMIUMS = ("chromium", "chromium-browser", "google-chrome")
LEAST_NODE = 20
TYPES = {".mjs": "text/javascript", ".mpd": "application/dash+xml", ".m4s": "video/iso.segment", ".mp4": "video/mp4"}


def _chromium() -> str | None:
    """The browser's program."""
    return next((path for name in CHROMIUMS if (path := shutil.which(name))), None)


@cache
def missing() -> tuple[str, ...]:
    """What a test in the browser needs and this machine lacks."""
    node = shutil.which("node")
    version = subprocess.run([node, "--version"], capture_output=True, text=True, check=True).stdout if node else "v0"
    found = {
        f"node {LEAST_NODE} or newer": int(version.strip().removeprefix("v").split(".")[0]) >= LEAST_NODE,
        "chromium": _chromium() is not None,
        "packages (npm ci --prefix web)": (WEB / "node_modules" / "playwright-core").is_dir(),
    }
    return tuple(what for what, there in found.items() if not there)


@dataclass(frozen=True)
class Site:
    """A running server of folders, and what was asked of it."""

    url: str  # without a slash at the end
    answers: list[tuple[str, int]]  # path and status of every answer, in order


@contextmanager
def serve(folders: Mapping[str, Path], made: Mapping[str, Callable[[], bytes]] | None = None) -> Iterator[Site]:
    """Python's own static server.

    `folders` are the first parts of paths, and what lies below them; `made` are paths whose bytes are made anew for
    each request.
    """
    answers: list[tuple[str, int]] = []

    class Handler(SimpleHTTPRequestHandler):
        extensions_map = SimpleHTTPRequestHandler.extensions_map | TYPES

        def do_GET(self) -> None:
            make = (made or {}).get(urlsplit(self.path).path)
            if make is None:
                return super().do_GET()
            data = make()
            self.send_response(200)
            self.send_header("Content-Type", self.guess_type(urlsplit(self.path).path))
            self.send_header("Content-Length", str(len(data)))
            self.end_headers()
            self.wfile.write(data)

        def translate_path(self, path: str) -> str:
            first, _, rest = unquote(urlsplit(path).path).lstrip("/").partition("/")
            return str(folders[first] / rest) if first in folders and ".." not in rest else os.devnull + "/"

        def log_request(self, code: int | str = "-", size: int | str = "-") -> None:
            answers.append((urlsplit(self.path).path, int(code)))

        def log_message(self, format: str, *args: object) -> None:
            """Nothing is printed."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield Site(f"http://127.0.0.1:{server.server_port}", answers)
        finally:
            server.shutdown()
            thread.join()


@dataclass(frozen=True)
class Visit:
    """What came of a page."""

    report: Any  # what its promise `window.report` gave
    messages: list[dict[str, str]]  # type and text of each line of its console
    failed: list[str]  # errors that nothing caught

    def complaints(self, known: tuple[str, ...] = ()) -> list[str]:
        """Errors, and errors and warnings of the console without a `known` part."""
        said = [m["text"] for m in self.messages if m["type"] in ("error", "warning")]
        return [*self.failed, *(text for text in said if not any(part in text for part in known))]


def visit(url: str) -> Visit:
    """Open a page and wait for its report."""
    environment = os.environ | {"CHROMIUM": str(_chromium())}
    command = ["node", str(WEB / "test" / "open.mjs"), url]
    done = subprocess.run(command, capture_output=True, text=True, timeout=180, env=environment)
    assert done.returncode == 0, done.stderr
    return Visit(**json.loads(done.stdout))

"""Folders and packages behind HTTP on this machine, for as long as a block runs."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

SERVE = "import sys; from airgs_codec.cli.serve import main; sys.exit(main())"


@contextmanager
def airgs_serve(package: Path, *options: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """`airgs-serve PACKAGE` in a process of its own, and its address, below which the package has its name."""
    command = [sys.executable, "-c", SERVE, str(package), "--port", "0", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout
            yield server, server.stdout.readline().split()[-1].rstrip("/")
        finally:
            server.terminate()


class _Quiet(SimpleHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def log_message(self, format: str, *args: object) -> None:
        """Nothing is said of requests."""


@contextmanager
def served_folder(folder: Path) -> Iterator[str]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=str(folder)))
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        server.server_close()

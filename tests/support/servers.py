"""Servers on loopback for the time of a block, and what is said to them byte by byte."""

import asyncio
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from http.client import HTTPConnection, HTTPMessage
from http.server import BaseHTTPRequestHandler, SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.request import Request, urlopen

from starlette.types import ASGIApp

from tests.faces import Packages, Scenes, bucket_at, listen, make_app, serve

Around = Callable[[ASGIApp], ASGIApp]


@contextmanager
def serving(
    *folders: Path,
    port: int = 0,
    around: Around = lambda app: app,
    patience_s: float = 20.0,
    home: Path | None = None,
    dropping: bool = True,
    say: Callable[[str], None] = print,
    **settings: Any,
) -> Iterator[int]:
    """The project's server, its application in what stands around it; gives its port. `home`: scenes are encoded."""
    packages = Packages([*folders, *([home] if home else [])])
    app = around(make_app(packages, Scenes(home, dropping, packages.find, say) if home else None))
    loop, stop, listening = asyncio.new_event_loop(), asyncio.Event(), listen("127.0.0.1", port, patience_s)

    def run() -> None:
        with asyncio.Runner(loop_factory=lambda: loop) as runner:
            runner.run(serve(app, listening, stop, patience_s=patience_s, **settings))

    port = listening.getsockname()[1]
    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield port
    finally:
        loop.call_soon_threadsafe(stop.set)
        thread.join()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    request_queue_size = 128  # of the usual 5, a browser on a busy machine loses some for a minute

    def handle_error(self, request: Any, client_address: Any) -> None:
        if not isinstance(sys.exception(), OSError):  # clients that go are no news
            super().handle_error(request, client_address)


@contextmanager
def answering(handler: Callable[..., BaseHTTPRequestHandler], port: int = 0) -> Iterator[int]:
    """Python's own server, whose requests `handler` answers; gives its port."""
    server = _Server(("127.0.0.1", port), handler)
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    try:
        yield server.server_address[1]
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def plainly_serving(folder: Path, protocol: str = "HTTP/1.1") -> AbstractContextManager[int]:
    """A server of a folder; of HTTP/1.0, it ends the connection after every file."""
    members = {"protocol_version": protocol, "log_message": lambda *_: None}
    return answering(partial(type("Handler", (SimpleHTTPRequestHandler,), members), directory=folder))


def ask(
    port: int, path: str, method: str = "GET", body: bytes | None = None, **headers: str
) -> tuple[int, HTTPMessage, bytes]:
    """Status, headers and body of an answer; `headers` of the request have _ in place of -."""
    connection = HTTPConnection("127.0.0.1", port, timeout=100)
    connection.request(method, path, body, {name.replace("_", "-"): value for name, value in headers.items()})
    response = connection.getresponse()
    data = response.read()
    connection.close()
    return response.status, response.headers, data


def say(port: int, data: bytes, wait_s: float = 10.0) -> bytes:
    """All that a server says to these bytes until it ends the connection. Raises TimeoutError if it does not."""
    with socket.create_connection(("127.0.0.1", port), wait_s) as connection:
        connection.sendall(data)
        answer = b""
        while part := connection.recv(1 << 16):
            answer += part
        return answer


@contextmanager
def object_store(bucket: str) -> Iterator[dict[str, str]]:
    """moto's S3 server with one empty bucket; gives the environment that leads to it."""
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    server.start()
    try:
        endpoint = "http://{}:{}".format(*server.get_host_and_port())
        with urlopen(Request(f"{endpoint}/{bucket}", method="PUT"), timeout=60):
            pass
        secret = {"AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test", "AWS_REGION": "us-east-1"}
        yield {"AWS_ENDPOINT": endpoint, "AWS_ALLOW_HTTP": "true", **secret}
    finally:
        server.stop()


def put_folder(folder: Path, address: str) -> str:
    """Put the files of a folder below an address, which it gives."""
    bucket = bucket_at(address)
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            bucket.write(path.relative_to(folder).as_posix(), path.read_bytes())
    return address

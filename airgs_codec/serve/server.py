"""The server: Hypercorn with limits on what a client may send and on how long it may take; a shaped link before it.

On that link, bytes of answers pass at the rate of a trace, and requests arrive a round trip late. It relays TCP
connections, so that it knows nothing of HTTP and whatever speaks over TCP is shaped alike.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import socket
import ssl
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hypercorn.asyncio import serve as serve_asgi
from hypercorn.config import Config
from starlette.types import ASGIApp

from airgs_codec.errors import ConfigError
from airgs_codec.play.trace import Trace
from airgs_codec.serve.app import HEAD_BYTES

CHUNK_BYTES = 4096  # that pass at once
IDLE_S = 0.005  # without an answer to pass: the link's time is lost
LATE_S = 0.25  # of a busy link that are made up for, when this program or the client was late
QUEUE = 64  # chunks of requests on their way
PATIENCE_S = 20.0
BACKLOG = 1024  # connections that wait to be taken
SILENCE = 6  # times the patience without a word from a client end its connection, even while it takes an answer
CONNECTION_REQUESTS = 1_000_000  # a viewer's connection lives as long as a sequence
LOG_FORMAT = '%(h)s - - %(t)s "%(m)s %(Uq)s HTTP/%(H)s" %(s)s %(b)s "%(f)s" "%(a)s"'  # Apache's combined log


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A link's rate over time, None for one without a limit, and its round trip."""

    trace: Trace | None
    rtt_s: float


class Bucket:
    """A token bucket that all connections share, filled as the trace says; its time begins with `begin`."""

    def __init__(self, trace: Trace, clock: Callable[[], float] = time.monotonic) -> None:
        self._trace, self._clock = trace, clock
        self._zero: float | None = None
        self._free_s = 0.0  # when all bytes before have passed

    def begin(self) -> None:
        """The first request is there; later calls do nothing."""
        if self._zero is None:
            self._zero = self._clock()

    def take(self, size: int, idle: bool = False) -> float:
        """Pass `size` bytes behind all before them; returns the seconds until the last one is through.

        They were there to pass as soon as the link was free, unless it was `idle` until now. Raises TransportError when
        the trace has ended.
        """
        self.begin()
        now_s = self._clock() - (self._zero or 0.0)
        self._free_s = self._trace.arrival_s(size, max(self._free_s, now_s if idle else now_s - LATE_S))
        return self._free_s - now_s


class Relay:
    """Takes connections and passes them on to `target` over a link."""

    def __init__(self, shape: Shape, target: tuple[str, int]) -> None:
        self._rtt_s, self._target = shape.rtt_s, target
        self._bucket = Bucket(shape.trace) if shape.trace else None
        self._open: set[asyncio.Task[None]] = set()

    async def run(self, listening: socket.socket) -> None:
        """Take connections of a listening socket until it is cancelled."""
        server = await asyncio.start_server(self._accept, sock=listening, limit=CHUNK_BYTES)
        try:
            await server.serve_forever()
        finally:
            for task in self._open:
                task.cancel()
            await asyncio.gather(*self._open, return_exceptions=True)

    def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.get_running_loop().create_task(self._pass_on(reader, writer))
        self._open.add(task)
        task.add_done_callback(self._open.discard)

    async def _pass_on(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One connection, until either side ends it."""
        with contextlib.closing(writer), contextlib.suppress(OSError):
            answers, server = await asyncio.open_connection(*self._target, limit=CHUNK_BYTES)
            with contextlib.closing(server):
                ways = [
                    asyncio.create_task(self._ask(reader, server)),
                    asyncio.create_task(self._answer(answers, writer)),
                ]
                try:
                    await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
                finally:
                    for way in ways:
                        way.cancel()
                    await asyncio.gather(*ways, return_exceptions=True)

    async def _ask(self, reader: asyncio.StreamReader, server: asyncio.StreamWriter) -> None:
        """Requests, each a round trip late."""
        queue: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue(QUEUE)
        delaying = asyncio.create_task(_delay(queue, server))
        try:
            data = b"-"
            while data:
                data = await reader.read(CHUNK_BYTES)
                if self._bucket:
                    self._bucket.begin()
                await queue.put((time.monotonic() + self._rtt_s, data))
            await delaying
        finally:
            delaying.cancel()

    async def _answer(self, answers: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answers, at the rate of the link."""
        asked_s = time.monotonic()
        while data := await answers.read(CHUNK_BYTES):
            if self._bucket:
                idle = time.monotonic() - asked_s > IDLE_S
                await asyncio.sleep(self._bucket.take(len(data), idle))
            writer.write(data)
            await writer.drain()
            asked_s = time.monotonic()


async def _delay(queue: asyncio.Queue[tuple[float, bytes]], server: asyncio.StreamWriter) -> None:
    """Write what is in the queue when it is due; nothing stands for the end."""
    while True:
        due_s, data = await queue.get()
        await asyncio.sleep(due_s - time.monotonic())
        if not data:
            server.write_eof()
            return
        server.write(data)
        await server.drain()


@dataclass(frozen=True, slots=True, eq=False)
class Certificate:
    """Files of a TLS certificate with its chain, and of its key, both PEM."""

    chain: Path
    key: Path


@dataclass(frozen=True, slots=True, eq=False)
class ServerSettings:
    """The settings of a server."""

    shape: Shape | None = None  # of the link, None: as fast as it goes
    certificate: Certificate | None = None  # for https and HTTP/2 in browsers
    patience_s: float = PATIENCE_S  # for the headers of a request, and for the next request
    grace_s: float = 3.0  # for answers under way when the server stops
    access_log: logging.Logger | None = None


def listen(host: str, port: int, patience_s: float = PATIENCE_S) -> socket.socket:
    """A socket that takes connections; port 0 stands for any free one.

    The kernel drops a client that takes nothing for `patience_s`, where it knows TCP_USER_TIMEOUT (RFC 5482).
    Connections inherit that and TCP_NODELAY from the socket; those made before `serve` runs have them, too.

    Raises ConfigError where nothing can listen.
    """
    if not 0 <= port < 1 << 16:
        raise ConfigError(f"port: expected 0 to 65535, got {port}")
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        listening = socket.create_server((host, port), family=family, backlog=BACKLOG)
    except (OSError, UnicodeError) as error:
        words = getattr(error, "strerror", None) or str(error)
        raise ConfigError(f"{host} port {port}: expected an address to listen at, got: {words}") from error
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # asyncio sees proto 0 here and leaves it out
    with contextlib.suppress(OSError):
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(1e3 * patience_s))
    return listening


def check_certificate(certificate: Certificate) -> None:
    """Raises ConfigError for files that are no certificate with its key."""
    try:
        ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(certificate.chain, certificate.key)
    except OSError as error:  # ssl.SSLError is one
        raise ConfigError(f"{certificate.chain}: expected a PEM certificate with its key, got: {error}") from error


async def serve(app: ASGIApp, listening: socket.socket, settings: ServerSettings, stop: asyncio.Event) -> None:
    """Serve an ASGI application on a listening socket, which it closes, until `stop` is set."""
    asyncio.get_running_loop().set_exception_handler(_report)
    if settings.shape is None:
        await _serve_asgi(app, listening, settings, stop.wait)
        return
    behind = listen("127.0.0.1", 0)
    relay = asyncio.create_task(Relay(settings.shape, behind.getsockname()[:2]).run(listening))
    try:
        await _serve_asgi(app, behind, settings, stop.wait)
    finally:
        relay.cancel()
        await asyncio.gather(relay, return_exceptions=True)


def _report(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Report what went wrong outside of all handlers; connections that break are no news."""
    if not isinstance(context.get("exception"), OSError):
        loop.default_exception_handler(context)


async def _serve_asgi(
    app: ASGIApp, listening: socket.socket, settings: ServerSettings, stop: Callable[[], Awaitable[object]]
) -> None:
    await serve_asgi(app, _config(listening, settings), shutdown_trigger=stop)  # type: ignore[arg-type]


def _config(listening: socket.socket, settings: ServerSettings) -> Config:
    config = Config()
    config.bind = [f"fd://{listening.detach()}"]
    config.backlog = BACKLOG
    config.h11_max_incomplete_size = config.h2_max_header_list_size = HEAD_BYTES
    config.keep_alive_timeout = settings.patience_s  # Hypercorn counts until the headers of a request are whole
    config.read_timeout = max(1, round(SILENCE * settings.patience_s))  # the only limit on HTTP/2 without a request
    config.keep_alive_max_requests = CONNECTION_REQUESTS
    config.graceful_timeout = settings.grace_s
    config.include_server_header = False
    config.errorlog = logging.getLogger("airgs_codec.serve")
    config.accesslog, config.access_log_format = settings.access_log, LOG_FORMAT
    if settings.certificate:
        config.certfile, config.keyfile = os.fspath(settings.certificate.chain), os.fspath(settings.certificate.key)
        config.ssl_handshake_timeout = settings.patience_s
    return config

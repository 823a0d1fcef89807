"""The server: Hypercorn with limits on what a client may send and on how long it may take."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import socket
import ssl
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hypercorn.asyncio import serve as serve_asgi
from hypercorn.config import Config
from priority import PriorityError
from starlette.types import ASGIApp

from airgs_codec.errors import ConfigError
from airgs_codec.serve.app import HEAD_BYTES

PATIENCE_S = 20.0
BACKLOG = 1024  # connections that wait to be taken
SILENCE = 6  # times the patience without a word from a client end its connection, even while it takes an answer
CONNECTION_REQUESTS = 1_000_000  # a viewer's connection lives as long as a sequence


@dataclass(frozen=True, slots=True, eq=False)
class Certificate:
    """Files of a TLS certificate with its chain, and of its key, both PEM."""

    chain: Path
    key: Path


@dataclass(frozen=True, slots=True, eq=False)
class ServerSettings:
    certificate: Certificate | None = None  # for https and HTTP/2 in browsers
    patience_s: float = PATIENCE_S  # for the headers of a request, and for the next request
    grace_s: float = 3.0  # for answers under way when the server stops


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
    await serve_asgi(app, _config(listening, settings), shutdown_trigger=stop.wait)  # type: ignore[arg-type]


def _report(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Report what went wrong outside of all handlers; a connection that breaks or asks too much is no news."""
    error = context.get("exception")
    if not error or BaseExceptionGroup("", [error]).split((OSError, PriorityError, asyncio.CancelledError))[1]:
        loop.default_exception_handler(context)


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
    if settings.certificate:
        config.certfile, config.keyfile = os.fspath(settings.certificate.chain), os.fspath(settings.certificate.key)
        config.ssl_handshake_timeout = settings.patience_s
    return config

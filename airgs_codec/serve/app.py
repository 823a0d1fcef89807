"""The server: Hypercorn, which serves files of packages below their names, a list of the packages, and the player.

Starlette sends files, with its ranges and conditions, in pieces as a connection takes them. Texts, which change while a
package grows, are read whole: what a client gets under one entity tag is one version, never a mixture of two.
"""

from __future__ import annotations

import asyncio
import contextlib
import gzip
import hashlib
import logging
import os
import re
import socket
import ssl
import stat
from pathlib import Path
from typing import Any

from hypercorn.asyncio import serve as serve_asgi
from hypercorn.config import Config
from priority import PriorityError
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from airgs_codec.errors import ConfigError
from airgs_codec.package.layout import INIT_NAME, JSON_NAME, MEDIA_TYPES, POSTER_NAME, belongs
from airgs_codec.package.package import REPR_DIGEST, repr_digest
from airgs_codec.package.tables import shorten
from airgs_codec.serve import pages
from airgs_codec.serve.pages import NOT_BUILT, PAGE_TYPES, content_policy, list_page, player_address
from airgs_codec.serve.scenes import MOST_BYTES, Scenes

LASTING = "public, max-age=31536000, immutable"
CHECKED = "no-cache"  # may be stored, but is asked for again each time
LEAST_ZIPPED_BYTES = 1024  # what fits one packet gains nothing
MOST_HELD_BYTES = 4 << 20  # of a text that is read whole and zipped; a longer one is sent in pieces
METHODS = "GET, HEAD, OPTIONS"
HEAD_BYTES = 16 * 1024  # of a request's target and headers
EVERYWHERE = {  # pages of any origin may read what is served here, and see its headers and times
    "Access-Control-Allow-Origin": "*",
    "Access-Control-Expose-Headers": "*",
    "Timing-Allow-Origin": "*",
    "X-Content-Type-Options": "nosniff",
}
PREFLIGHT = {
    "Allow": METHODS,
    "Access-Control-Allow-Methods": METHODS,
    "Access-Control-Allow-Headers": "If-None-Match, If-Range, Range",
    "Access-Control-Max-Age": "86400",
}
OWN_HOST = re.compile(r"(localhost|[0-9.]+|\[[0-9a-f:.]+\])(:[0-9]+)?")  # no name that DNS of others can lead here
OWN_PAGE = "the page of this server itself, at localhost, a number or https, if it takes files: see --drop"
_TEXT = (".json", ".mpd", ".html", ".js")  # the only files that are not compressed already
_FILES = StaticFiles()

PATIENCE_S = 20.0
BACKLOG = 1024  # connections that wait to be taken
SILENCE = 6  # times the patience without a word from a client end its connection, even while it takes an answer
CONNECTION_REQUESTS = 1_000_000  # a viewer's connection lives as long as a sequence


class Packages:
    """The folders of packages by their names, of those named one by one and those in folders that hold packages."""

    def __init__(self, folders: list[Path]) -> None:
        """`folders`: packages, and folders that hold packages, of which new ones are found as they appear.

        Raises ConfigError for a folder of neither kind and for two packages of one name.
        """
        self._named = {path.resolve().name: path.absolute() for path in folders if _is_package(path)}
        self._holders = [path.absolute() for path in folders if not _is_package(path)]
        names: set[str] = set()
        for folder in folders:
            found = [folder.resolve().name] if _is_package(folder) else [*_packages_in(folder)]
            # without any files but hidden ones: packages may be on their way
            is_empty = folder.is_dir() and all(path.name.startswith(".") for path in folder.iterdir())
            if not found and not is_empty:
                kinds = f"a package with {JSON_NAME}, a folder with packages or an empty one, or frames"
                raise ConfigError(f"{folder}: expected {kinds}, got nothing of that kind")
            if twice := names.intersection(found):
                raise ConfigError(f"{folder}: expected packages of different names, got {min(twice)} twice")
            names.update(found)

    def now(self) -> dict[str, Path]:
        """Return the packages of this moment. Of two with one name, that of the folder which was named first."""
        found: dict[str, Path] = {}
        for holder in reversed(self._holders):
            found |= _packages_in(holder)
        return found | self._named

    def find(self, name: str) -> Path | None:
        return self._named.get(name) or next(filter(_is_listed, (holder / name for holder in self._holders)), None)


def _is_package(folder: Path) -> bool:
    return os.path.isfile(folder / JSON_NAME)  # False, too, where it may not be looked at


def _is_listed(folder: Path) -> bool:
    """Return whether a folder is a package: no link, nothing hidden, and no name that an address cannot have."""
    name = folder.name
    return not name.startswith(".") and name.isprintable() and not os.path.islink(folder) and _is_package(folder)


def _packages_in(holder: Path) -> dict[str, Path]:
    try:
        names = sorted(os.listdir(holder))
    except OSError:
        return {}
    return {name: holder / name for name in names if _is_listed(holder / name)}


def media_type(path: str) -> str | None:
    """Return the media type of a file of a package by its path, None for a path that no file of a package has."""
    name = path.rpartition("/")[2]
    return MEDIA_TYPES.get(name[name.index(".") :]) if belongs(path) else None


def find_file(folder: Path, path: str) -> tuple[str, os.stat_result] | None:
    """Return a plain file below a folder that can be read, with no link on the way to it, or None."""
    try:
        file = os.path.realpath(folder / path, strict=True)
        found = os.stat(file)
    except OSError:
        return None
    direct = file == os.path.join(os.path.realpath(folder), path)
    return (file, found) if direct and stat.S_ISREG(found.st_mode) and os.access(file, os.R_OK) else None


def make_app(packages: Packages, scenes: Scenes | None = None) -> Starlette:

    async def index(request: Request) -> Response:
        page = await asyncio.to_thread(lambda: list_page(packages.now(), scenes.as_html() if scenes else ""))
        return HTMLResponse(page, headers={"Cache-Control": CHECKED, "Content-Security-Policy": content_policy(page)})

    async def drop(request: Request) -> Response:
        """Take a file; the answer is where it will be played, or why it is refused."""
        assert scenes
        body = request.stream()
        try:
            name = await scenes.take(request.query_params.get("name", ""), body)
            return Response(status_code=202, headers={"Location": player_address(name)})
        except (ConfigError, OSError) as error:
            async for _ in body:  # browsers read no answer before they have sent all
                pass
            return PlainTextResponse(f"{getattr(error, 'strerror', None) or error}\n", 400)

    async def player(request: Request) -> Response:
        name = request.path_params["page"]
        kind = PAGE_TYPES.get(name)
        response = await asyncio.to_thread(_answer, request, pages.PAGE_FOLDER, name, kind) if kind else None
        return response or PlainTextResponse(f"{NOT_BUILT if kind else 'no such file'}\n", 404)

    async def file(request: Request) -> Response:
        """Return a file of a package; the folder itself leads to the player."""
        name, path = request.path_params["name"], request.path_params["path"]
        kind, response = media_type(path), None
        if (kind or not path) and (folder := await asyncio.to_thread(packages.find, name)):
            if not kind:
                return RedirectResponse(f"..{player_address(name)}", 307, {"Cache-Control": CHECKED})
            response = await asyncio.to_thread(_answer, request, folder, path, kind)
        return response or PlainTextResponse("no such file\n", 404)

    # A page is never a file of a package: those lie below a name.
    routes = [Route("/", index), Route("/", drop, methods=["POST"])]
    routes += [Route("/{page}", player), Route("/{name}/{path:path}", file)]
    app = Starlette(routes=routes, middleware=[Middleware(_gate, scenes)], lifespan=scenes.encoding if scenes else None)
    app.router.redirect_slashes = False
    return app


def _gate(app: ASGIApp, scenes: Scenes | None) -> ASGIApp:
    """Return an application that answers OPTIONS, refuses bodies and huge headers, and adds headers to responses."""

    async def gated(scope: Scope, receive: Receive, send: Send) -> None:
        async def send_more(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(EVERYWHERE)
            await send(message)

        chosen = (_refusal(scope, scenes) or app) if scope["type"] == "http" else app
        # Where the connection is broken, or the file is gone, the answer ends.
        with contextlib.suppress(OSError, ClientDisconnect):
            await chosen(scope, receive, send_more)

    return gated


def _refusal(scope: Scope, scenes: Scenes | None) -> Response | None:
    headers = Headers(scope=scope)
    sizes = [len(scope["raw_path"]), len(scope["query_string"]), *(len(n) + len(v) for n, v in headers.raw)]
    end = {"Connection": "close"}  # so that what follows a refusal is never taken for a request
    dropped = (scope["method"], scope["path"]) == ("POST", "/")
    if not dropped and scope["method"] not in METHODS.split(", "):
        return PlainTextResponse(f"expected {METHODS}\n", 405, {**end, "Allow": METHODS})
    if sum(sizes) > HEAD_BYTES:
        return PlainTextResponse(f"expected at most {HEAD_BYTES} bytes of headers\n", 431, end)
    scheme, host, length = scope["scheme"], headers.get("host", ""), headers.get("content-length", "0")
    own = headers.get("origin") == f"{scheme}://{host}" and (scheme == "https" or OWN_HOST.fullmatch(host))
    if dropped and not (scenes and scenes.dropping and own):
        return PlainTextResponse(f"expected a file from {OWN_PAGE}\n", 403, end)
    most = MOST_BYTES if dropped else 0
    if "transfer-encoding" in headers or not length.isdecimal() or int(length) > most:
        return PlainTextResponse(f"expected at most {most} bytes, and their number\n", 413, end)
    return Response(status_code=204, headers=PREFLIGHT) if scope["method"] == "OPTIONS" else None


def _answer(request: Request, folder: Path, path: str, kind: str) -> Response | None:
    found = find_file(folder, path)
    if found is None:
        return None
    file, status = found
    lasting = "/" in path or path in (INIT_NAME, POSTER_NAME)  # neither a root of a package nor the page
    caching = {"Cache-Control": LASTING if lasting else CHECKED}
    if not path.endswith(_TEXT) or status.st_size > MOST_HELD_BYTES:
        response = _FILES.file_response(file, status, request.scope)
        response.headers.update(caching if response.status_code == 304 else {"Content-Type": kind, **caching})
        return response
    try:
        data = Path(file).read_bytes()
    except OSError:
        return None
    tag = shorten(hashlib.sha256(data).digest())
    zipped = len(data) >= LEAST_ZIPPED_BYTES and "gzip" in request.headers.get("accept-encoding", "").lower()
    headers = Headers({"ETag": f'"{tag}-gzip"' if zipped else f'"{tag}"', "Vary": "Accept-Encoding", **caching})
    if _FILES.is_not_modified(headers, request.headers):
        return Response(status_code=304, headers=headers)
    response = Response(gzip.compress(data, 6, mtime=0) if zipped else data, 200, headers, kind)
    if zipped:
        response.headers["Content-Encoding"] = "gzip"
    if not lasting:  # no table says what its bytes are
        response.headers[REPR_DIGEST] = repr_digest(bytes(response.body))
    if kind == "text/html":
        response.headers["Content-Security-Policy"] = content_policy(data.decode())
    return response


def listen(host: str, port: int, patience_s: float = PATIENCE_S) -> socket.socket:
    """Return a socket that takes connections; port 0 stands for any free one.

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


def check_certificate(chain: Path, key: Path) -> None:
    """Raise ConfigError for PEM files that are no certificate with its key."""
    try:
        ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(chain, key)
    except OSError as error:  # ssl.SSLError is one
        raise ConfigError(f"{chain}: expected a PEM certificate with its key, got: {error}") from error


async def serve(
    app: ASGIApp,
    listening: socket.socket,
    stop: asyncio.Event,
    certificate: tuple[Path, Path] | None = None,
    patience_s: float = PATIENCE_S,
    grace_s: float = 3.0,
) -> None:
    """Serve an ASGI application on a listening socket, which it closes, until `stop` is set.

    `certificate`: PEM files of a TLS certificate with its chain, and of its key, for https and HTTP/2 in browsers;
    `patience_s`: for the headers of a request, and for the next request; `grace_s`: for answers under way at the end.
    """
    config = Config()
    config.bind = [f"fd://{listening.detach()}"]
    config.backlog = BACKLOG
    config.h11_max_incomplete_size = config.h2_max_header_list_size = HEAD_BYTES
    config.keep_alive_timeout = patience_s  # Hypercorn counts until the headers of a request are whole
    config.read_timeout = max(1, round(SILENCE * patience_s))  # the only limit on HTTP/2 without a request
    config.keep_alive_max_requests = CONNECTION_REQUESTS
    config.graceful_timeout = grace_s
    config.include_server_header = False
    config.errorlog = logging.getLogger("airgs_codec.serve")
    if certificate:
        config.certfile, config.keyfile = map(os.fspath, certificate)
        config.ssl_handshake_timeout = patience_s
    asyncio.get_running_loop().set_exception_handler(_report)
    await serve_asgi(app, config, shutdown_trigger=stop.wait)  # type: ignore[arg-type]


def _report(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Report what went wrong outside of all handlers; a connection that breaks or asks too much is no news."""
    error = context.get("exception")
    if not error or BaseExceptionGroup("", [error]).split((OSError, PriorityError, asyncio.CancelledError))[1]:
        loop.default_exception_handler(context)

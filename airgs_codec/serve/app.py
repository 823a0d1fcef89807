"""The application: files of packages below their names, a list of the packages above them, and the player.

Starlette sends files, with its ranges and conditions, in pieces as a connection takes them. Texts, which change while a
package grows, are read whole: what a client gets under one entity tag is one version, never a mixture of two.
"""

from __future__ import annotations

import asyncio
import contextlib
import gzip
import hashlib
import os
import re
import stat
from collections.abc import Mapping
from pathlib import Path

from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from airgs_codec.errors import ConfigError
from airgs_codec.package.layout import INIT_NAME, JSON_NAME, MEDIA_TYPES, POSTER_NAME, ROOTS
from airgs_codec.package.package import REPR_DIGEST, repr_digest
from airgs_codec.package.tables import shorten
from airgs_codec.serve import pages
from airgs_codec.serve.pages import NOT_BUILT, PAGE_TYPES, addresses, content_policy, list_page, player_address

LASTING = "public, max-age=31536000, immutable"
CHECKED = "no-cache"  # may be stored, but is asked for again each time
LEAST_ZIPPED_BYTES = 1024  # what fits one packet gains nothing
MOST_HELD_BYTES = 4 << 20  # of a text that is read whole and zipped; a longer one is sent in pieces
METHODS = "GET, HEAD, OPTIONS"
POLICY = "Content-Security-Policy"
HEAD_BYTES = 16 * 1024  # of a request's target and headers
EVERYWHERE = {  # pages of any origin may read what is served here, and see its headers and times
    "Access-Control-Allow-Origin": "*",
    "Access-Control-Expose-Headers": "*",
    "Timing-Allow-Origin": "*",
    "X-Content-Type-Options": "nosniff",
}
NOTHING_MORE: Mapping[str, str] = {}
PREFLIGHT = {
    "Allow": METHODS,
    "Access-Control-Allow-Methods": METHODS,
    "Access-Control-Allow-Headers": "If-None-Match, If-Range, Range",
    "Access-Control-Max-Age": "86400",
}
_BELOW = r"(?:group|index|key|sound|state)/(?:[A-Za-z0-9_-]+/){0,3}[A-Za-z0-9_-]+(?:\.[a-z0-9]+){1,2}"
_PATH = re.compile("|".join([*map(re.escape, (*ROOTS, INIT_NAME, POSTER_NAME)), _BELOW]), re.ASCII)
_TEXT = (".json", ".mpd", ".html", ".js")  # the only files that are not compressed already
_FILES = StaticFiles()


class Packages:
    """The folders of packages by their names: those named one by one, and those in folders that hold packages."""

    def __init__(self, folders: list[Path]) -> None:
        """`folders`: packages, and folders that hold packages, of which new ones are found as they appear.

        Raises ConfigError for a folder of neither kind and for two packages of one name.
        """
        self._named: dict[str, Path] = {}
        self._holders: list[Path] = []
        self._known: dict[str, Path] = {}
        for folder in folders:
            own = _is_package(folder)
            found = {folder.resolve().name: folder.absolute()} if own else _packages_in(folder)
            if not found and not _is_empty(folder):
                kinds = f"a package with {JSON_NAME}, a folder with packages or an empty one"
                raise ConfigError(f"{folder}: expected {kinds}, got nothing of that kind")
            for name in sorted(found.keys() & self._known.keys()):
                raise ConfigError(f"{found[name]}: expected packages of different names, got {name} twice")
            self._known |= found
            if own:
                self._named |= found
            else:
                self._holders.append(folder.absolute())

    def now(self) -> dict[str, Path]:
        """Those that are there now. Where a name has come up twice, the folder that was named first has it."""
        found: dict[str, Path] = {}
        for holder in reversed(self._holders):
            found |= _packages_in(holder)
        self._known = found | self._named
        return dict(self._known)

    def find(self, name: str) -> Path | None:
        """The folder of a package, None where there is no such package."""
        return self._known.get(name) or self.now().get(name)


def _is_package(folder: Path) -> bool:
    return os.path.isfile(folder / JSON_NAME)  # False, too, where it may not be looked at


def _is_empty(folder: Path) -> bool:
    """Whether a folder has no files but hidden ones: packages may be on their way."""
    return folder.is_dir() and all(path.name.startswith(".") for path in folder.iterdir())


def _packages_in(holder: Path) -> dict[str, Path]:
    """The packages in a folder: no links, nothing hidden, and no name that an address cannot have."""
    try:
        with os.scandir(holder) as entries:
            names = sorted(entry.name for entry in entries if entry.is_dir(follow_symlinks=False))
    except OSError:
        return {}
    usable = (name for name in names if not name.startswith(".") and name.isprintable())
    return {name: holder.absolute() / name for name in usable if _is_package(holder / name)}


def media_type(path: str) -> str | None:
    """The media type of a file of a package by its path, None for a path that no file of a package has."""
    if not _PATH.fullmatch(path):
        return None
    name = path.rpartition("/")[2]
    return MEDIA_TYPES.get(name[name.index(".") :])


def find_file(folder: Path, path: str) -> tuple[str, os.stat_result] | None:
    """A plain file below a folder that can be read, no link on the way to it; None if there is none."""
    try:
        file = os.path.realpath(folder / path, strict=True)
        found = os.stat(file)
    except OSError:
        return None
    direct = file == os.path.join(os.path.realpath(folder), path)
    return (file, found) if direct and stat.S_ISREG(found.st_mode) and os.access(file, os.R_OK) else None


def make_app(packages: Packages) -> Starlette:
    """The ASGI application that serves these packages."""
    site = _Site(packages)
    routes = [
        Route("/", site.index),
        Route("/{page}", site.page),  # never a file of a package: those lie below a name
        Route("/{name}/{path:path}", site.file),
    ]
    app = Starlette(routes=routes, middleware=[Middleware(_Gate)])
    app.router.redirect_slashes = False
    return app


class _Gate:
    """Refuses requests with a body or huge headers, answers OPTIONS, and adds to every response what all have."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def send_more(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(EVERYWHERE)
            await send(message)

        with contextlib.suppress(OSError):  # the connection is broken, or the file is gone: the answer ends
            await self._choose(scope)(scope, receive, send_more)

    def _choose(self, scope: Scope) -> ASGIApp:
        if scope["method"] not in METHODS.split(", "):
            return _refusal(f"expected {METHODS}", 405, {"Allow": METHODS})
        headers = Headers(scope=scope)
        target = len(scope["raw_path"]) + len(scope["query_string"])
        if target + sum(len(name) + len(value) for name, value in headers.raw) > HEAD_BYTES:
            return _refusal(f"expected at most {HEAD_BYTES} bytes of headers", 431)
        if "transfer-encoding" in headers or headers.get("content-length", "0") != "0":
            return _refusal("expected no body", 413)
        return Response(status_code=204, headers=PREFLIGHT) if scope["method"] == "OPTIONS" else self._app


def _refusal(words: str, status: int, headers: Mapping[str, str] = NOTHING_MORE) -> Response:
    """Ends the connection, too, so that what follows is never taken for a request."""
    return PlainTextResponse(f"{words}\n", status, {"Connection": "close", **headers})


class _Site:
    def __init__(self, packages: Packages) -> None:
        self._packages = packages

    async def index(self, request: Request) -> Response:
        """The packages, as JSON where the client asks for it, else as a page."""
        headers = {"Cache-Control": CHECKED, "Vary": "Accept"}
        packages = await asyncio.to_thread(self._packages.now)
        if "application/json" in request.headers.get("accept", ""):
            return JSONResponse([addresses(name) for name in sorted(packages)], headers=headers)
        page = await asyncio.to_thread(list_page, packages)
        return HTMLResponse(page, headers=headers | {POLICY: content_policy(page)})

    async def page(self, request: Request) -> Response:
        name = request.path_params["page"]
        kind = PAGE_TYPES.get(name)
        if kind is None:
            return PlainTextResponse("no such file\n", 404)
        response = await asyncio.to_thread(_answer, request, pages.PAGE, name, kind)
        return response or PlainTextResponse(f"{NOT_BUILT}\n", 404)

    async def file(self, request: Request) -> Response:
        """A file of a package; the folder itself leads to the player."""
        name, path = request.path_params["name"], request.path_params["path"]
        if not path and name in await asyncio.to_thread(self._packages.now):
            return RedirectResponse(f"..{player_address(name)}", 307, {"Cache-Control": CHECKED})
        kind = media_type(path)
        folder = await asyncio.to_thread(self._packages.find, name) if kind else None
        response = await asyncio.to_thread(_answer, request, folder, path, kind) if kind and folder else None
        return response or PlainTextResponse("no such file\n", 404)


def _answer(request: Request, folder: Path, path: str, kind: str) -> Response | None:
    """The response with a file; None where there is none."""
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
        response.headers[POLICY] = content_policy(data.decode())
    return response

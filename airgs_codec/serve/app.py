"""The application: files of packages below their names, a list of the packages above them, and the player.

A request for a file is answered with conditions, ranges and content coding (RFC 9110).
"""

from __future__ import annotations

import asyncio
import contextlib
import re
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping

from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import (
    HTMLResponse,
    JSONResponse,
    PlainTextResponse,
    RedirectResponse,
    Response,
    StreamingResponse,
)
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from airgs_codec.package.tables import shorten
from airgs_codec.play.repr_digest import REPR_DIGEST, repr_value
from airgs_codec.serve.cards import list_page
from airgs_codec.serve.files import PackageFiles, Snapshot, Version
from airgs_codec.serve.pages import NOT_BUILT, PAGE_TYPES, addresses, content_policy, player_address

LASTING = "public, max-age=31536000, immutable"
CHECKED = "no-cache"  # may be stored, but is asked for again each time
PIECE_BYTES = 1 << 16  # read for a connection and given to it at once, so that a slow one holds little memory
_RANGE = re.compile(r"\s*bytes\s*=\s*(\d*)\s*-\s*(\d*)\s*", re.ASCII | re.IGNORECASE)
_DIGITS = 18  # of a position in a file; one with more lies behind every end
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


class Body(StreamingResponse):
    """A response whose body is read in pieces, each when the connection has taken the one before.

    It ends with the connection; where a piece cannot be read, the connection ends with it.
    """

    def __init__(
        self, version: Version, part: range, status_code: int, headers: Mapping[str, str], media_type: str
    ) -> None:
        self._long = len(part) > PIECE_BYTES
        length = {"Content-Length": str(len(part))}
        super().__init__(_pieces(version.read, part), status_code, {**headers, **length}, media_type)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send it (ASGI); nothing is read for HEAD."""
        if scope["method"] == "HEAD":
            self.body_iterator = _pieces(Version.of(b"").read, range(0))
        if self._long:
            await super().__call__(scope, receive, send)
        else:  # nobody need look whether the connection ends meanwhile
            await self.stream_response(send)


async def _pieces(read: Callable[[int, int], bytes], part: range) -> AsyncIterator[bytes]:
    for start in range(part.start, part.stop, PIECE_BYTES):
        yield await asyncio.to_thread(read, start, min(start + PIECE_BYTES, part.stop))


def answer(snapshot: Snapshot, asked: Mapping[str, str]) -> Response:
    """The response to GET with the headers `asked` (names in lower case): 200, 206, 304 or 416.

    Several ranges in one request are answered with the whole file, as RFC 9110 section 14.2 allows.
    """
    zipped = None if "range" in asked or not _takes_gzip(asked) else snapshot.zipped
    version, tag = zipped or snapshot.plain, shorten(snapshot.plain.sha256)
    tag = f'"{tag}"' if zipped is None else f'"{tag}-gzip"'
    headers = {"ETag": tag, "Cache-Control": LASTING if snapshot.lasting else CHECKED, "Accept-Ranges": "bytes"}
    if not snapshot.lasting:  # no table says what its bytes are
        headers[REPR_DIGEST] = repr_value(version.sha256)
    if snapshot.zipped is not None:
        headers["Vary"] = "Accept-Encoding"
    if _is_known(asked.get("if-none-match", ""), tag):
        return Response(status_code=304, headers=headers)
    if zipped is not None:
        headers["Content-Encoding"] = "gzip"
    part = _part(asked, tag, version.size)
    if part is None:
        return Body(version, range(version.size), 200, headers, snapshot.media_type)
    if not part:
        return Response(status_code=416, headers={"Content-Range": f"bytes */{version.size}"})
    headers["Content-Range"] = f"bytes {part.start}-{part.stop - 1}/{version.size}"
    return Body(version, part, 206, headers, snapshot.media_type)


def parse_range(text: str, size: int) -> range | None:
    """The bytes that a Range header asks for, of `size`: an empty range if there are none of them.

    None where the header is to be ignored: no range of bytes, or several.
    """
    match = _RANGE.fullmatch(text)
    if not match or not any(match.groups()):
        return None
    first, last = (_position(digits) for digits in match.groups())
    if first is None:  # the last so many bytes
        return range(max(0, size - (last or 0)), size)
    if last is not None and last < first:
        return None
    return range(min(first, size), size if last is None else min(last + 1, size))


def _position(digits: str) -> int | None:
    digits = digits.lstrip("0") or digits[:1]
    return (int(digits) if len(digits) <= _DIGITS else 10**_DIGITS) if digits else None


def _part(asked: Mapping[str, str], tag: str, size: int) -> range | None:
    if asked.get("if-range", tag) != tag:
        return None
    return parse_range(asked.get("range", ""), size)


def _is_known(header: str, tag: str) -> bool:
    """Return whether If-None-Match names the tag; the comparison is the weak one, as it has to be."""
    return header.strip() == "*" or tag in (part.strip().removeprefix("W/") for part in header.split(","))


def _takes_gzip(asked: Mapping[str, str]) -> bool:
    for part in asked.get("accept-encoding", "").lower().split(","):
        coding, _, weight = part.partition(";")
        if coding.strip() == "gzip":
            return not re.fullmatch(r"\s*q\s*=\s*0(\.0*)?\s*", weight)
    return False


def make_app(files: PackageFiles) -> Starlette:
    """The ASGI application that serves these packages."""
    site = _Site(files)
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

        with contextlib.suppress(OSError):  # the connection is broken: nobody waits for the rest
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
    def __init__(self, files: PackageFiles) -> None:
        self._files = files

    async def index(self, request: Request) -> Response:
        """The packages, as JSON where the client asks for it, else as a page."""
        headers = {"Cache-Control": CHECKED, "Vary": "Accept"}
        packages = await asyncio.to_thread(lambda: self._files.packages)
        if "application/json" in request.headers.get("accept", ""):
            return JSONResponse([addresses(name) for name in sorted(packages)], headers=headers)
        page = await asyncio.to_thread(list_page, packages)
        return HTMLResponse(page, headers=headers | {POLICY: content_policy(page)})

    async def page(self, request: Request) -> Response:
        """A file of the player."""
        name = request.path_params["page"]
        if name not in PAGE_TYPES:
            return _missing("no such file")
        return await _respond(self._files.read_page(name), request, NOT_BUILT)

    async def file(self, request: Request) -> Response:
        """A file of a package; the folder itself leads to the player."""
        name, path = request.path_params["name"], request.path_params["path"]
        if not path and name in await asyncio.to_thread(lambda: self._files.packages):
            return RedirectResponse(f"..{player_address(name)}", 307, {"Cache-Control": CHECKED})
        return await _respond(self._files.read(**request.path_params), request, "no such file")


async def _respond(reading: Awaitable[Snapshot | None], request: Request, missing: str) -> Response:
    try:
        snapshot = await reading
    except OSError:
        return PlainTextResponse("this file cannot be read now\n", 503, {"Retry-After": "1"})
    if snapshot is None:
        return _missing(missing)
    response = answer(snapshot, request.headers)
    if snapshot.media_type == "text/html":
        page = snapshot.plain.read(0, snapshot.plain.size)
        response.headers[POLICY] = content_policy(page.decode())
    return response


def _missing(words: str) -> Response:
    return PlainTextResponse(f"{words}\n", 404)

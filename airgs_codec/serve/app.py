"""What the server answers: files of packages below their names; above them a list of the packages, and the player."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable

from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from airgs_codec.serve.answers import CHECKED, answer
from airgs_codec.serve.files import PackageFiles, Snapshot
from airgs_codec.serve.listing import addresses, list_page
from airgs_codec.serve.player import NOT_BUILT, PAGE_TYPES, content_policy

METHODS = "GET, HEAD, OPTIONS"
POLICY = "Content-Security-Policy"
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
        headers = Headers(scope=scope)
        target = len(scope["raw_path"]) + len(scope["query_string"])
        if target + sum(len(name) + len(value) for name, value in headers.raw) > HEAD_BYTES:
            return _refusal(f"expected at most {HEAD_BYTES} bytes of headers", 431)
        if "transfer-encoding" in headers or headers.get("content-length", "0") != "0":
            return _refusal("expected no body", 413)
        return Response(status_code=204, headers=PREFLIGHT) if scope["method"] == "OPTIONS" else self._app


def _refusal(words: str, status: int) -> Response:
    """Ends the connection, too, so that what follows is never taken for a request."""
    return PlainTextResponse(f"{words}\n", status, {"Connection": "close"})


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
        return await _answer(self._files.read_page(name), request, NOT_BUILT)

    async def file(self, request: Request) -> Response:
        """A file of a package."""
        return await _answer(self._files.read(**request.path_params), request, "no such file")


async def _answer(reading: Awaitable[Snapshot | None], request: Request, missing: str) -> Response:
    try:
        snapshot = await reading
    except OSError:
        return PlainTextResponse("this file cannot be read now\n", 503, {"Retry-After": "1"})
    if snapshot is None:
        return _missing(missing)
    response = answer(snapshot, request.headers)
    if snapshot.media_type == "text/html":
        response.headers[POLICY] = content_policy(snapshot.data.decode())
    return response


def _missing(words: str) -> Response:
    return PlainTextResponse(f"{words}\n", 404)

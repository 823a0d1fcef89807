"""What the server answers: the files of packages below their names, and a list of the packages."""

from __future__ import annotations

import contextlib
import html
from urllib.parse import quote

from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from airgs_codec.package.paths import JSON_NAME, MPD_NAME
from airgs_codec.serve.answers import CHECKED, answer
from airgs_codec.serve.files import PackageFiles

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


def make_app(files: PackageFiles) -> Starlette:
    """The ASGI application that serves these packages."""
    site = _Site(files)
    routes = [
        Route("/", site.index),
        # A page that plays the packages is mounted here, before them.
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
        names = sorted(self._files.packages)
        if "application/json" in request.headers.get("accept", ""):
            return JSONResponse([_addresses(name) for name in names], headers=headers)
        rows = "".join(f"<li>{_links(name)}</li>\n" for name in names)
        page = f'<!doctype html>\n<meta charset="utf-8">\n<title>Packages</title>\n<ul>\n{rows}</ul>\n'
        return HTMLResponse(page, headers=headers)

    async def file(self, request: Request) -> Response:
        """A file of a package."""
        try:
            snapshot = await self._files.read(**request.path_params)
        except OSError:
            return PlainTextResponse("this file cannot be read now\n", 503, {"Retry-After": "1"})
        if snapshot is None:
            return PlainTextResponse("no such file\n", 404)
        return answer(snapshot, request.headers)


def _addresses(name: str) -> dict[str, str]:
    folder = f"/{quote(name)}"
    return {"name": name, "tables": f"{folder}/{JSON_NAME}", "mpd": f"{folder}/{MPD_NAME}"}


def _links(name: str) -> str:
    a = _addresses(name)
    link = '<a href="{}">{}</a>'.format
    words = html.escape(name), link(html.escape(a["tables"]), JSON_NAME), link(html.escape(a["mpd"]), MPD_NAME)
    return " ".join(words)

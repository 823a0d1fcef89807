"""A server whose answers a test chooses while it runs."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from starlette.datastructures import MutableHeaders
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from tests.support.servers import serving

WRONG = 0  # in the place of a status: the file with a wrong byte
SILENT = 1  # its headers, and no byte for as long as the answer to the next question is the same
LOOK_S = 0.02
Fault = Callable[[str, int], int | None]  # path below the package, number of the request -> status or one of these


def outage(trigger: str, seconds: float, status: int) -> Fault:
    """A fault of all answers for a while, from the first request for a file on."""
    begun: list[float] = []

    def fault(path: str, _: int) -> int | None:
        if path == trigger and not begun:
            begun.append(time.monotonic())
        return status if begun and time.monotonic() < begun[0] + seconds else None

    return fault


@dataclass
class Moods:
    """What a server does with requests, none of whose answers a browser keeps."""

    fault: Fault = lambda path, number: None
    asked: Counter[str] = field(default_factory=Counter)  # paths below the package

    def around(self, app: ASGIApp) -> ASGIApp:
        async def moody(scope: Scope, receive: Receive, send: Send) -> None:
            if scope["type"] != "http":
                await app(scope, receive, send)
                return
            path = scope["path"].split("/", 2)[-1]
            self.asked[path] += 1
            fault = self.fault(path, self.asked[path])
            if fault not in (None, WRONG, SILENT):
                await Response("sorry", fault, {"Access-Control-Allow-Origin": "*"})(scope, receive, send)
                return

            async def send_on(message: Message) -> None:
                if message["type"] == "http.response.start":
                    MutableHeaders(scope=message)["Cache-Control"] = "no-store"
                elif fault == WRONG and message.get("body"):
                    message["body"] = bytes([message["body"][0] ^ 1]) + message["body"][1:]
                while message["type"] == "http.response.body" and self.fault(path, self.asked[path]) == SILENT:
                    await asyncio.sleep(LOOK_S)
                await send(message)

            await app(scope, receive, send_on)

        return moody


class Switch:
    """A server that can be away and come back at the same port."""

    def __init__(self, folder: Path, moods: Moods) -> None:
        self._folder, self._moods = folder, moods
        self._up = ExitStack()
        self.port = 0
        self.begin()

    def begin(self) -> bytes:
        around = serving(self._folder, port=self.port, around=self._moods.around)
        self.port = self._up.enter_context(around)
        return b"begun"

    def end(self) -> bytes:
        self._up.close()
        return b"ended"


@contextmanager
def moodily_serving(folder: Path, moods: Moods) -> Iterator[Switch]:
    switch = Switch(folder, moods)
    with contextlib.closing(switch._up):
        yield switch

"""A link in front of a server: bytes of answers pass at the rate of a trace, requests arrive a round trip late.

It relays TCP connections, so that it knows nothing of HTTP and whatever speaks over TCP is shaped alike.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass

from airgs_codec.play.trace import Trace

CHUNK_BYTES = 4096  # that pass at once
IDLE_S = 0.005  # without an answer to pass: the link's time is lost
LATE_S = 0.25  # of a busy link that are made up for, when this program or the client was late
QUEUE = 64  # chunks of requests on their way


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

"""A slow link in front of a server on this machine: answers pass at the rate of a trace, requests a round trip late.

It relays TCP connections, so that it knows nothing of HTTP. All connections share the one link.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from airgs_codec.play.trace import Trace

CHUNK_BYTES = 4096  # that pass at once
IDLE_S = 0.005  # without an answer to pass: the link's time is lost
LATE_S = 0.25  # of a busy link that are made up for, when this program or the client was late
QUEUE = 64  # chunks of requests on their way


@contextmanager
def shaped(port: int, trace: Trace, rtt_s: float) -> Iterator[int]:
    """A port of this machine that leads to another one over a link, whose time begins with the first request."""
    loop = asyncio.new_event_loop()
    relay = _Relay(port, Bucket(trace), rtt_s)
    server = loop.run_until_complete(asyncio.start_server(relay.accept, "127.0.0.1", 0, limit=CHUNK_BYTES))
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        asyncio.run_coroutine_threadsafe(_end(server), loop).result()
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


async def _end(server: asyncio.Server) -> None:
    """Take no more connections, and end those that are open."""
    server.close()
    others = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
    for task in others:
        task.cancel()
    await asyncio.gather(*others, return_exceptions=True)


class Bucket:
    """A token bucket that all connections share, filled as the trace says; its time begins with `begin`."""

    def __init__(self, trace: Trace, clock: Callable[[], float] = time.monotonic) -> None:
        self._trace, self._clock = trace, clock
        self._zero: float | None = None
        self._free_s = 0.0  # when all bytes before have passed

    def begin(self) -> None:
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


class _Relay:
    def __init__(self, port: int, bucket: Bucket, rtt_s: float) -> None:
        self._port, self._bucket, self._rtt_s = port, bucket, rtt_s

    async def accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        queue: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue(QUEUE)
        with contextlib.closing(writer), contextlib.suppress(OSError, asyncio.CancelledError):
            answers, server = await asyncio.open_connection("127.0.0.1", self._port, limit=CHUNK_BYTES)
            with contextlib.closing(server):
                asking = asyncio.create_task(self._ask(reader, queue))
                ways = [asyncio.create_task(_delay(queue, server)), asyncio.create_task(self._answer(answers, writer))]
                try:
                    await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
                finally:
                    for way in (asking, *ways):
                        way.cancel()
                    await asyncio.gather(asking, *ways, return_exceptions=True)

    async def _ask(self, reader: asyncio.StreamReader, queue: asyncio.Queue[tuple[float, bytes]]) -> None:
        """Queue requests with the time when they are due; nothing stands for the end."""
        data = b"-"
        while data:
            data = await reader.read(CHUNK_BYTES)
            self._bucket.begin()
            await queue.put((time.monotonic() + self._rtt_s, data))

    async def _answer(self, answers: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        asked_s = time.monotonic()
        while data := await answers.read(CHUNK_BYTES):
            await asyncio.sleep(self._bucket.take(len(data), idle=time.monotonic() - asked_s > IDLE_S))
            writer.write(data)
            await writer.drain()
            asked_s = time.monotonic()


async def _delay(queue: asyncio.Queue[tuple[float, bytes]], server: asyncio.StreamWriter) -> None:
    """Write what is in the queue when it is due, to the end."""
    data = b"-"
    while data:
        due_s, data = await queue.get()
        await asyncio.sleep(due_s - time.monotonic())
        server.write(data)
        await server.drain()

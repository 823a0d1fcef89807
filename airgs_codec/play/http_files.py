"""Single files over HTTP: asked for again, later and later, until what comes is right or it is no use.

A server that cannot be reached, or says that it is busy (429, 502, 503, 504), is waited for as long as `outage_s`. Any
other fault is the file's: after `attempts` of them the file cannot be had, as one with status 404 at once. A redirect
is followed on the server itself, never to another scheme, host or port. airgs.json, which is asked for again and again
while a package grows, may come compressed, and not at all where it is what came before (If-None-Match).
"""

from __future__ import annotations

import asyncio
import itertools
import os
import random
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace

import aiohttp
from yarl import URL

from airgs_codec._settings import documented, setting
from airgs_codec.errors import ConfigError, FormatError, TransportError
from airgs_codec.package.layout import JSON_NAME
from airgs_codec.play.downloader import Retry
from airgs_codec.play.repr_digest import REPR_DIGEST, check_repr_digest

BUSY = (429, 502, 503, 504)
GARBLED = ("size_mismatch", "hash_mismatch", "not_json")  # reasons to ask again
LONGEST_PAUSE_S = 4.0
LEAST_BYTES = 4096  # that come within the time-out: 16 connections over a modem of 18 kbit/s are faster
STATUS_LINE_BYTES = len("HTTP/1.1 200 OK\r\n\r\n")
ZIPPED = 16 + zlib.MAX_WBITS  # gzip, for zlib
FRESH = {"Cache-Control": "no-cache"}  # asks caches on the way, which may hold wrong bytes, to ask the server


@documented
@dataclass(frozen=True, slots=True)
class HttpSettings:
    """Patience with a server. Raises ConfigError for settings that cannot work."""

    timeout_s: float = setting(30.0, "seconds for the next 4 KiB of an answer, after which it is asked for again")
    attempts: int = setting(4, "faulty answers after which a file cannot be had")
    backoff_s: float = setting(0.25, "seconds before an answer is asked for again, doubled each time")
    outage_s: float = setting(60.0, "seconds that a server may be away")
    as_fast: bool = setting(False, "let no time pass where the buffer is full")

    def __post_init__(self) -> None:
        for name, value in (("time-out", self.timeout_s), ("back-off", self.backoff_s)):
            if not value > 0:
                raise ConfigError(f"{name}: expected more than 0 s, got {value:g}")
        if self.attempts < 1 or not self.outage_s >= 0:
            raise ConfigError("expected an attempt or more, and an outage of 0 s or more")


@dataclass(slots=True, eq=False)
class Transfer:
    """A batch under way; times are those of `time.monotonic`."""

    first_byte_at: float | None = None
    wait_s: float = float("inf")  # the shortest from a request to its first byte
    bytes: int = 0  # headers included
    whole: set[str] = field(default_factory=set)
    refused: dict[str, FormatError] = field(default_factory=dict)
    retries: list[Retry] = field(default_factory=list)

    def begin(self, asked_at: float) -> None:
        """The head of an answer is there."""
        now = time.monotonic()
        self.first_byte_at = now if self.first_byte_at is None else self.first_byte_at
        self.wait_s = min(self.wait_s, now - asked_at)


class _PassingError(FormatError):
    """An answer that did not come whole; another may."""

    def __init__(self, path: str, words: str, away: bool = False) -> None:
        super().__init__("missing_file", path, words)
        self.away = away  # the server, not the file


def connect(settings: HttpSettings, connections: int) -> aiohttp.ClientSession:
    """Connections of a `FileClient`. Bodies come as they are: the tables list digests of what is on the server."""

    async def begin(session: object, context: SimpleNamespace, sent: object) -> None:
        context.trace_request_ctx.restart()

    trace = aiohttp.TraceConfig()
    trace.on_request_headers_sent.append(begin)
    return aiohttp.ClientSession(
        connector=aiohttp.TCPConnector(limit=connections),
        timeout=aiohttp.ClientTimeout(total=None, sock_connect=settings.timeout_s),
        auto_decompress=False,
        headers={"Accept-Encoding": "identity"},
        trace_configs=[trace],
    )


class _Window:
    """The time for the next LEAST_BYTES of an answer; it begins when the request is sent."""

    def __init__(self, timeout_s: float) -> None:
        self._timeout_s, self._came = timeout_s, 0
        self.limit = asyncio.timeout(None)

    def restart(self) -> None:
        """Give all of the time again."""
        self._came = 0
        self.limit.reschedule(asyncio.get_running_loop().time() + self._timeout_s)

    def count(self, size: int) -> None:
        """So many bytes came."""
        self._came += size
        if self._came >= LEAST_BYTES:
            self.restart()


@dataclass(frozen=True, slots=True, eq=False)
class FileClient:
    """Fetches files below a URL; `accept` takes them in, or raises FormatError."""

    session: aiohttp.ClientSession
    url: str
    settings: HttpSettings
    accept: Callable[[str, bytes], None]
    last: dict[str, tuple[str, bytes]] = field(default_factory=dict)  # by path, entity tag and bytes of airgs.json

    async def get(self, path: str, limit: int, transfer: Transfer, outage_s: float) -> None:
        """Fetch a file of at most `limit` bytes, and say in `transfer` what came of it.

        Raises TransportError when the server is away for longer than `outage_s`.
        """
        faults, away_since = 0, None
        for tries in itertools.count():
            answer = _Answer(self, path, limit, transfer)
            fault = await answer.fault(again=tries > 0)
            if fault is None:
                transfer.whole.add(path)
                return
            away, now = isinstance(fault, _PassingError) and fault.away, time.monotonic()
            faults, away_since = (faults, away_since or now) if away else (faults + 1, None)
            if away_since is not None and now - away_since >= outage_s:
                raise TransportError(f"{self.url}: {fault.detail}")
            if faults == self.settings.attempts or not _may_pass(fault):
                transfer.refused[path] = fault
                return
            transfer.retries.append(Retry(path, fault.detail, answer.size))
            await asyncio.sleep(self._pause_s(tries))

    def _pause_s(self, tries: int) -> float:
        """Longer each time, and not the same for everybody who lost the same server."""
        longest = min(LONGEST_PAUSE_S, self.settings.backoff_s * 2 ** min(tries, 30))
        return longest * random.uniform(0.5, 1.0)


def _may_pass(fault: FormatError) -> bool:
    return isinstance(fault, _PassingError) or fault.reason in GARBLED


@dataclass(slots=True, eq=False)
class _Answer:
    """What comes of one request for a file."""

    client: FileClient
    path: str
    limit: int
    transfer: Transfer
    size: int = 0  # bytes that came, headers included

    async def fault(self, again: bool) -> FormatError | None:
        """Why the file was not accepted, None if it was."""
        if again:
            self.client.last.pop(self.path, None)
        try:
            self.client.accept(self.path, await self._receive(FRESH if again else {}))
        except FormatError as error:
            self.client.last.pop(self.path, None)
            return error
        except (aiohttp.ClientSSLError, aiohttp.InvalidURL) as error:
            raise TransportError(f"{self.client.url}: {error}") from error
        except (aiohttp.ClientConnectorError, aiohttp.ConnectionTimeoutError) as error:
            return _PassingError(self.path, f"the server cannot be reached: {_reason(error)}", away=True)
        except TimeoutError:
            words = f"broken off: fewer than {LEAST_BYTES} bytes in {self.client.settings.timeout_s:g} s"
            return _PassingError(self.path, words)
        except (aiohttp.ClientError, OSError) as error:
            return _PassingError(self.path, f"broken off: {_reason(error)}")
        return None

    async def _receive(self, headers: dict[str, str]) -> bytes:
        asked_at, window = time.monotonic(), _Window(self.client.settings.timeout_s)
        tag, last = self.client.last.get(self.path, ("", b""))
        conditional = {"If-None-Match": tag} if tag else {}
        changing = self.path == JSON_NAME
        packed = {"Accept-Encoding": "gzip"} if self.path in self.client.last else {}  # the first is as it is listed
        asking = self.client.session.get(
            f"{self.client.url}/{self.path}",
            headers=headers | packed | conditional,
            middlewares=(self._stay,),
            trace_request_ctx=window,
        )
        async with window.limit, asking as response:
            self._count(STATUS_LINE_BYTES + sum(len(name) + len(value) + 4 for name, value in response.raw_headers))
            self.transfer.begin(asked_at)
            if response.status == 304 and tag:
                return last
            if response.status != 200:
                raise _refusal(self.path, response.status)
            data = await self._body(response.content, window)
        check_repr_digest(self.path, data, response.headers.get(REPR_DIGEST, ""))
        if changing and response.headers.get("Content-Encoding") == "gzip":
            data = self._unzip(data)
        if changing:
            self.client.last[self.path] = response.headers.get("ETag", ""), data
        return data

    def _unzip(self, data: bytes) -> bytes:
        inflate = zlib.decompressobj(ZIPPED)
        try:
            text = inflate.decompress(data, self.limit + 1)
        except zlib.error as error:
            raise FormatError("not_json", self.path, f"expected gzip: {error}") from error
        if len(text) > self.limit or not inflate.eof:
            raise FormatError("not_json", self.path, f"expected gzip of at most {self.limit} bytes")
        return text

    async def _stay(self, request: aiohttp.ClientRequest, pass_on: aiohttp.ClientHandlerType) -> aiohttp.ClientResponse:
        """Pass on a request to the server itself. Raises FormatError for one to another, after a redirect."""
        origin, asked = URL(self.client.url).origin(), request.url.origin()
        if asked != origin:
            raise FormatError("missing_file", self.path, f"expected a file of {origin}, got a redirect to {asked}")
        return await pass_on(request)

    async def _body(self, stream: aiohttp.StreamReader, window: _Window) -> bytes:
        body = bytearray()
        async for data in stream.iter_any():
            self._count(len(data))
            window.count(len(data))
            body += data
            if len(body) > self.limit:
                raise FormatError("size_mismatch", self.path, f"expected at most {self.limit} bytes, got more")
        return bytes(body)

    def _count(self, size: int) -> None:
        self.size += size
        self.transfer.bytes += size


def _refusal(path: str, status: int) -> FormatError:
    words = f"expected a file, got status {status}"
    if status >= 500 or status in BUSY:
        return _PassingError(path, words, away=status in BUSY)
    return FormatError("missing_file", path, words)


def _reason(error: Exception) -> str:
    number = getattr(error, "errno", None)
    return os.strerror(number) if number else str(error) or type(error).__name__

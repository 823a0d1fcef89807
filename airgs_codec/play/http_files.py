"""Single files over HTTP: asked for again, later and later, until what comes is right or it is no use.

A server that cannot be reached, or says that it is busy (429, 502, 503, 504), is waited for as long as `outage_s`. Any
other fault is the file's: after `attempts` of them the file cannot be had, as one with status 404 at once.
"""

from __future__ import annotations

import asyncio
import itertools
import os
import random
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import aiohttp

from airgs_codec._settings import documented, setting
from airgs_codec.errors import ConfigError, FormatError, TransportError
from airgs_codec.play.downloader import Retry
from airgs_codec.play.repr_digest import REPR_DIGEST, check_repr_digest

BUSY = (429, 502, 503, 504)
GARBLED = ("size_mismatch", "hash_mismatch", "not_json")  # reasons to ask again
LONGEST_PAUSE_S = 4.0
STATUS_LINE_BYTES = len("HTTP/1.1 200 OK\r\n\r\n")
FRESH = {"Cache-Control": "no-cache"}  # asks caches on the way, which may hold wrong bytes, to ask the server


@documented
@dataclass(frozen=True, slots=True)
class HttpSettings:
    """Patience with a server. Raises ConfigError for settings that cannot work."""

    timeout_s: float = setting(30.0, "seconds without a byte after which an answer is asked for again")
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


@dataclass(frozen=True, slots=True, eq=False)
class FileClient:
    """Fetches files below a URL; `accept` takes them in, or raises FormatError."""

    session: aiohttp.ClientSession
    url: str
    settings: HttpSettings
    accept: Callable[[str, bytes], None]

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
        try:
            self.client.accept(self.path, await self._receive(FRESH if again else {}))
        except FormatError as error:
            return error
        except (aiohttp.ClientSSLError, aiohttp.InvalidURL) as error:
            raise TransportError(f"{self.client.url}: {error}") from error
        except (aiohttp.ClientConnectorError, aiohttp.ConnectionTimeoutError) as error:
            return _PassingError(self.path, f"the server cannot be reached: {_reason(error)}", away=True)
        except (aiohttp.ClientError, OSError) as error:  # TimeoutError is one
            return _PassingError(self.path, f"broken off: {_reason(error)}")
        return None

    async def _receive(self, headers: dict[str, str]) -> bytes:
        asked_at = time.monotonic()
        async with self.client.session.get(f"{self.client.url}/{self.path}", headers=headers) as response:
            self._count(STATUS_LINE_BYTES + sum(len(name) + len(value) + 4 for name, value in response.raw_headers))
            self.transfer.begin(asked_at)
            if response.status != 200:
                raise _refusal(self.path, response.status)
            data = await self._body(response.content)
        check_repr_digest(self.path, data, response.headers.get(REPR_DIGEST, ""))
        return data

    async def _body(self, stream: aiohttp.StreamReader) -> bytes:
        body = bytearray()
        async for data in stream.iter_any():
            self._count(len(data))
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

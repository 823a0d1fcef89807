"""Batches over a real HTTP connection, by the real clock: the other Downloader.

The files of a batch are requested at once, each over a connection of its own (HTTP/1.1, left open), so that they share
a round trip and then the link, as on the simulated one. What arrives is checked against the tables before it counts.

A server that cannot be reached, answers nothing, or says that it is busy (429, 502, 503, 504), is waited for as long as
`outage_s`. Any other fault is the file's: after `attempts` of them, or a status 404, it cannot be had. A redirect is
followed on the server itself, never to another scheme, host or port; the query of the package's address goes with every
file. Servers may compress what they send. airgs.json is asked for again and again while a
package grows, with If-None-Match.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import itertools
import math
import os
import random
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from urllib.parse import quote, urlsplit

import aiohttp
from yarl import URL

from airgs_codec._settings import documented, setting
from airgs_codec.errors import ConfigError, FormatError, TransportError
from airgs_codec.package.layout import JSON_NAME, group_path, locate
from airgs_codec.package.manifest import Manifest, count_groups
from airgs_codec.package.package import REPR_DIGEST, check_file, check_repr_digest, folder_of, open_manifest
from airgs_codec.package.parse import MAX_TABLE_BYTES, inflate, parse_root
from airgs_codec.package.tables import PAGE, FileEntry, Header, Root
from airgs_codec.places.place import BUSY, CIRCLE, SILENCE_S, WEB, got_words, split_query, status_words
from airgs_codec.play.downloader import CHECK_S, Arrival, BatchKind, GiveUp, Partial, Request, Retry
from airgs_codec.play.offers import Batch, Offers

CONNECTIONS = 16  # at once
GROWS = ("frames", "live", "rungs")  # what of the header changes while a package grows
GARBLED = ("size_mismatch", "hash_mismatch", "not_json")  # reasons to ask again
LONGEST_PAUSE_S = 4.0
LEAST_BYTES = 1024  # that come within the time-out: 16 connections over a modem of 18 kbit/s are faster
STATUS_LINE_BYTES = len("HTTP/1.1 200 OK\r\n\r\n")
_AS_IT_IS = "!$%&'()*+,/:;=?@"  # in a query: a signature may be of its letters
FRESH = {"Cache-Control": "no-cache"}  # asks caches on the way, which may hold wrong bytes, to ask the server


@documented
@dataclass(frozen=True, slots=True)
class HttpSettings:
    """Patience with a server. Raises ConfigError for settings that cannot work."""

    timeout_s: float = setting(SILENCE_S, "seconds for the next KiB of an answer, after which it is asked for again")
    attempts: int = setting(4, "faulty answers after which a file cannot be had")
    backoff_s: float = setting(0.25, "seconds before an answer is asked for again, doubled each time")
    outage_s: float = setting(60.0, "seconds that a server may be away")
    as_fast: bool = setting(False, "let no time pass where the buffer is full")

    def __post_init__(self) -> None:
        for name, value in (("time-out", self.timeout_s), ("back-off", self.backoff_s)):
            if not 0 < value < math.inf:
                raise ConfigError(f"{name}: expected more than 0 s, got {value:g}")
        if self.attempts < 1 or not 0 <= self.outage_s < math.inf:
            raise ConfigError("expected an attempt or more, and an outage of 0 s or more")


@dataclass(slots=True, eq=False)
class Transfer:
    """A batch under way; times are those of `time.monotonic`."""

    first_byte_at: float | None = None
    answered_at: float = -math.inf  # when a file began to come last
    reported: bool = False  # that something is asked for again
    wait_s: float = math.inf  # the shortest from a request to its first byte
    bytes: int = 0  # headers included
    whole: set[str] = field(default_factory=set)
    refused: dict[str, FormatError] = field(default_factory=dict)
    retries: list[Retry] = field(default_factory=list)


class _Answer:
    """One answer of a batch, and the time for its next LEAST_BYTES, which begins when the request is sent."""

    def __init__(self, transfer: Transfer, timeout_s: float) -> None:
        self.asked_at, self.size = time.monotonic(), 0  # bytes that came, headers included
        self.limit = asyncio.timeout(timeout_s)
        self._transfer, self._timeout_s, self._since = transfer, timeout_s, 0

    def begin(self, response: aiohttp.ClientResponse) -> None:
        now, transfer = time.monotonic(), self._transfer
        self.count(STATUS_LINE_BYTES + sum(len(name) + len(value) + 4 for name, value in response.raw_headers))
        transfer.first_byte_at = now if transfer.first_byte_at is None else transfer.first_byte_at
        transfer.wait_s = min(transfer.wait_s, now - self.asked_at)
        if response.status not in BUSY:
            transfer.answered_at = now

    def count(self, size: int) -> None:
        self.size += size
        self._transfer.bytes += size
        self._since += size
        if self._since >= LEAST_BYTES:
            self._since = 0
            self.limit.reschedule(asyncio.get_running_loop().time() + self._timeout_s)


class _PassingError(FormatError):
    """An answer that did not come whole; another may. `away`: the server is, whatever the file."""

    def __init__(self, path: str, words: str, away: bool = False) -> None:
        super().__init__("missing_file", path, words)
        self.away = away


class HttpDownloader(contextlib.AbstractContextManager["HttpDownloader"]):
    """Fetches a package from a server; `received` is given every file that came whole and is what the tables say.

    Time is seconds from the first request. With `as_fast`, waiting for room in the buffer takes none; a package that
    grows is played in real time. Raises ConfigError for a URL that is not http or https.
    """

    pipelines = False  # batches follow each other: the player knows that one is over only when it is

    def __init__(
        self,
        url: str,
        settings: HttpSettings | None = None,
        received: Callable[[str, bytes], object] | None = None,
        on_retry: Callable[[str], object] | None = None,
    ) -> None:
        """`on_retry` is called with a line of text when files of a batch are requested again."""
        self._settings, self._received, self._on_retry = settings or HttpSettings(), received, on_retry
        self._url, self._query = _checked(url)
        self._tables = RemoteTables()
        self._tag: str | None = None  # entity tag of airgs.json, once it was accepted, '' without one
        self._connections = asyncio.Semaphore(CONNECTIONS)
        self._runner = asyncio.Runner()
        self._session = self._runner.run(self._connect())
        self._zero: float | None = None  # of the clock
        self._skipped_s = 0.0
        self._rtt_s = math.inf
        self._opened: dict[tuple[str, ...], Arrival] = {}  # what came before the player asks for it

    def __exit__(self, *_: object) -> None:
        self._runner.run(self._session.close())
        self._runner.close()

    @property
    def rtt_s(self) -> float:
        return self._rtt_s if self._rtt_s < math.inf else 0.0

    def open(self) -> Offers:
        """Fetch airgs.json, which answers the player's first request. Return offers, which grow with the tables.

        A session over a growing package begins with its newest group. Raises FormatError, TransportError where there is
        no server.
        """
        self._fetch_first(JSON_NAME)
        c = self._offers
        if c.live:
            places = c.manifest.groups.places
            for path in places.pages_to("segments", places.segments - 1):
                self._fetch_first(path)
            c.first = places.entry(places.groups - 1).first_segment
        return c

    def _fetch_first(self, path: str) -> None:
        arrival = self.fetch(Request(BatchKind.TABLES, 0, 0, Batch(tables=(path,)), 0.0, 0.0))
        for error in arrival.refused.values():
            raise FormatError(error.reason, f"{self._url}/{error.where}", error.detail)
        self._opened[path,] = arrival

    def fetch(self, request: Request, give_up: GiveUp | None = None) -> Arrival:
        """See Downloader. Raises TransportError for a server that is away for too long."""
        if opened := self._opened.pop(request.batch.files, None):
            return replace(opened, request=request)
        return self._runner.run(self._fetch(request, give_up))

    @property
    def _offers(self) -> Offers:
        if self._tables.offers is None:
            raise ConfigError("expected open() before fetch()")
        return self._tables.offers

    async def _connect(self) -> aiohttp.ClientSession:
        """Return a session whose bodies come as they are: tables list digests of what is on the server."""
        connector, timeout = aiohttp.TCPConnector(limit=0), aiohttp.ClientTimeout(total=None)
        as_it_is = {"Accept-Encoding": "identity"}
        return aiohttp.ClientSession(connector=connector, timeout=timeout, auto_decompress=False, headers=as_it_is)

    async def _fetch(self, request: Request, give_up: GiveUp | None) -> Arrival:
        if (left_s := request.sent_s - self._now_s()) > 0:
            if self._settings.as_fast and not self._offers.live:
                self._skipped_s += left_s
            else:
                await asyncio.sleep(left_s)
        transfer, files = Transfer(), request.batch.files
        limits = [self._tables.limit(path) for path in files]
        tasks = [asyncio.create_task(self._get(*one, transfer)) for one in zip(files, limits, strict=True)]
        try:
            abandoned = await self._watch(tasks, transfer, self._offers.wire_bytes(files) if give_up else 0, give_up)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        self._rtt_s = min(self._rtt_s, transfer.wait_s)
        now_s, size, retries = self._now_s(), max(1, transfer.bytes), tuple(transfer.retries)
        first_s = now_s if transfer.first_byte_at is None else self._at_s(transfer.first_byte_at)
        whole = tuple(path for path in files if path in transfer.whole)
        return Arrival(request, first_s, now_s, size, whole, transfer.refused, abandoned, retries)

    async def _watch(
        self, tasks: list[asyncio.Task[None]], transfer: Transfer, expected: int, give_up: GiveUp | None
    ) -> bool:
        """Wait for all files, asking `give_up` every CHECK_S after the first byte; returns whether it said yes."""
        waiting, look_s = set(tasks), CHECK_S
        while waiting:
            since_s = 0.0 if transfer.first_byte_at is None else time.monotonic() - transfer.first_byte_at
            limit_s = max(0.0, look_s - since_s) if give_up else None
            done, waiting = await asyncio.wait(waiting, timeout=limit_s, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
            if give_up is None or not waiting or transfer.first_byte_at is None:
                continue
            elapsed_s = time.monotonic() - transfer.first_byte_at
            if elapsed_s >= look_s:
                look_s += CHECK_S
                if give_up(Partial(self._now_s(), elapsed_s, float(transfer.bytes), expected)):
                    return True
        return False

    async def _get(self, path: str, limit: int, transfer: Transfer) -> None:
        """Fetch a file of at most `limit` bytes and record the outcome in `transfer`.

        Raises TransportError when the server is away for too long: before airgs.json has come, at once.
        """
        outage_s = self._settings.outage_s if self._tables.offers else 0.0
        faults, away_since = 0, None
        for tries in itertools.count():
            try:
                async with self._connections:
                    answer = _Answer(transfer, self._settings.timeout_s)
                    data = await self._receive(path, limit, answer, again=tries > 0)
                self._tables.accept(path, data)
                if self._received is not None:
                    self._received(path, data)
                transfer.whole.add(path)
                return
            except (FormatError, aiohttp.ClientError, OSError) as error:
                fault = self._fault(path, error, away=transfer.answered_at < answer.asked_at)
            if path == JSON_NAME:
                self._tag = None
            passing, now = isinstance(fault, _PassingError), time.monotonic()
            away = isinstance(fault, _PassingError) and fault.away
            faults, away_since = (faults, away_since or now) if away else (faults + 1, None)
            if away_since is not None and now - away_since >= outage_s:
                raise TransportError(f"{self._url}/{path}: {fault.detail}")
            if faults == self._settings.attempts or not (passing or fault.reason in GARBLED):
                transfer.refused[path] = fault
                return
            if passing and self._on_retry and not transfer.reported:
                transfer.reported = True
                self._on_retry(f"{self._url}/{path}: {fault.detail}; asking again")
            transfer.retries.append(Retry(path, fault.detail, answer.size))
            pause_s = min(LONGEST_PAUSE_S, self._settings.backoff_s * 2 ** min(tries, 30))
            await asyncio.sleep(pause_s * random.uniform(0.5, 1.0))  # clients of one server do not return together

    def _fault(self, path: str, error: Exception, away: bool) -> FormatError:
        """Return what an error means for a file; `away`: the server has sent nothing since the request."""
        match error:
            case FormatError():
                return error
            case aiohttp.ClientSSLError() | aiohttp.InvalidURL():
                raise TransportError(f"{self._url}: {error}") from error
            case aiohttp.ClientConnectorError():
                return _PassingError(path, f"the server cannot be reached: {_reason(error)}", away=True)
            case TimeoutError():
                words = f"the server is silent: fewer than {LEAST_BYTES} bytes in {self._settings.timeout_s:g} s"
                return _PassingError(path, words, away)
            case aiohttp.TooManyRedirects():
                return FormatError("missing_file", path, f"expected a file, got none: {CIRCLE} at {error.args[0].url}")
        return _PassingError(path, f"broken off: {_reason(error)}")

    async def _receive(self, path: str, limit: int, answer: _Answer, again: bool) -> bytes:
        """Return the bytes of a file, unzipped if the server zipped it. Raises FormatError and errors of aiohttp."""
        headers = dict(FRESH) if again else {}
        tag = self._tag if path == JSON_NAME else None
        if tag is not None:  # the first, and one after a fault, is as it is listed
            headers = {"Accept-Encoding": "gzip"} | ({"If-None-Match": tag} if tag else {})
        url, stay = URL(f"{self._url}/{path}{self._query}", encoded=True), partial(self._stay, path)
        asking = self._session.get(url, headers=headers, middlewares=(stay,))
        async with answer.limit, asking as response:
            answer.begin(response)
            if response.status == 304 and tag:
                return self._tables.root_bytes
            if response.status in BUSY or response.status >= 500:
                raise _PassingError(path, status_words(response.status), away=response.status in BUSY)
            if response.status != 200:
                raise FormatError("missing_file", path, status_words(response.status))
            body = bytearray()
            async for part in response.content.iter_any():
                answer.count(len(part))
                body += part
                if len(body) > limit:
                    words = f"expected at most {limit} bytes, got {got_words(bytes(body), 'more')}"
                    raise FormatError("size_mismatch", path, words)
        data = bytes(body)
        check_repr_digest(path, data, response.headers.get(REPR_DIGEST, ""))
        if response.headers.get("Content-Encoding") == "gzip" and not path.endswith(".gz"):
            data = inflate(data, path)
        if path == JSON_NAME:
            self._tag = response.headers.get("ETag", "")
        return data

    async def _stay(
        self, path: str, request: aiohttp.ClientRequest, pass_on: aiohttp.ClientHandlerType
    ) -> aiohttp.ClientResponse:
        """Pass on a request. Raises FormatError for a redirect to another server."""
        origin, asked = URL(self._url).origin(), request.url.origin()
        if asked != origin:
            raise FormatError("missing_file", path, f"expected a file of {origin}, got a redirect to {asked}")
        return await pass_on(request)

    def _now_s(self) -> float:
        return self._at_s(time.monotonic())

    def _at_s(self, clock: float) -> float:
        self._zero = clock if self._zero is None else self._zero
        return clock - self._zero + self._skipped_s


def _reason(error: Exception) -> str:
    if isinstance(error, aiohttp.ClientPayloadError):
        return "the answer is shorter than it says"
    number = getattr(error, "errno", None)
    return os.strerror(number) if number and number > 0 else str(error) or type(error).__name__


def _checked(url: str) -> tuple[str, str]:
    """Return the URL of a package's folder, without the slash at its end, and its query. Raises ConfigError."""
    before, query = split_query(folder_of(url))
    try:
        parts = urlsplit(before)
        valid = parts.scheme in WEB and parts.hostname and parts.port != 0 and "#" not in url
    except ValueError:
        valid = False
    if not valid:
        raise ConfigError(f"URL: expected http://HOST[:PORT]/PATH[?QUERY] or https, got {url}")
    return str(URL(before)).rstrip("/"), quote(query, safe=_AS_IT_IS)


class RemoteTables:
    """Offers that grow with the tables that are accepted."""

    def __init__(self) -> None:
        self.offers: Offers | None = None  # None: airgs.json has not come yet
        self._root: Root | None = None
        self.root_bytes = b""
        self._files: dict[str, tuple[FileEntry, bytes]] = {}  # pages and tables of groups
        self._keepers: dict[int, set[int]] = {}  # groups whose tables came, by the group whose rows they keep

    def limit(self, path: str) -> int:
        """Return the most bytes that a file may have. Raises FormatError for a file that no table lists."""
        return self.offers.manifest.entry(path).bytes if self.offers and path != JSON_NAME else MAX_TABLE_BYTES

    def accept(self, path: str, data: bytes) -> None:
        """Check a file against the tables, and store it if it is one. Raises FormatError."""
        if path == JSON_NAME:
            self._accept_root(data)
            return
        if self.offers is None:
            raise FormatError("missing_entry", path, f"{JSON_NAME} has not come yet")
        m = self.offers.manifest
        entry, (what, numbers) = m.entry(path), locate(path)
        check_file(path, data, entry)
        if what not in ("group", "page"):
            return
        self._files[path] = entry, data
        try:
            if what == "group":
                self._check_base(m, numbers[0] - 1)
            else:
                m.groups.places.check_page(numbers[0], numbers[1] - 1)
        except FormatError:
            del self._files[path]
            raise

    def _accept_root(self, data: bytes) -> None:
        if data == self.root_bytes:
            return
        root = parse_root(data)
        if self._root is not None:
            _check_growth(self._root, root)
        manifest = open_manifest(root, self._find)
        if self.offers is None:
            self.offers = Offers(manifest, root_bytes=len(data), live=root.live)
        else:
            self.offers.grow(manifest, len(data))
        self._root, self.root_bytes = root, data

    def _find(self, path: str, entry: FileEntry) -> bytes:
        """Return a fetched table. Raises FormatError if it has not come, or if the root now lists another."""
        if path not in self._files:
            raise FormatError("missing_file", path, "it has not been fetched")
        listed, data = self._files[path]
        if listed != entry:
            raise FormatError("hash_mismatch", path, "the table that came is not the one that is listed now")
        return data

    def _check_base(self, m: Manifest, group: int) -> None:
        """Parse a group's table and check it against its base, whichever came first. Raises FormatError."""
        base = m.groups[group].base
        for number in self._keepers.get(group, ()):
            m.base_of(number)
        if base is not None:
            if group_path(base) in self._files:
                m.base_of(group)
            self._keepers.setdefault(base - 1, set()).add(group)


def _check_growth(before: Root, after: Root) -> None:
    """Raise FormatError(bad_value) unless a root can follow another while groups are added."""
    fixed = {field.name for field in dataclasses.fields(Header)}.difference(GROWS)
    same = all(getattr(before, name) == getattr(after, name) for name in fixed)
    was, now = count_groups(before.index), count_groups(after.index)
    extends = now >= was
    for level, (old, new) in enumerate(zip(before.index, after.index, strict=False)):
        if was // PAGE ** (level + 1) == now // PAGE ** (level + 1):  # no page of the level above was filled since
            extends = extends and new.sha256.startswith(old.sha256)
    if not (same and extends and after.frames >= before.frames and before.live >= after.live):
        raise FormatError("bad_value", JSON_NAME, "expected the package of before with more groups, got another")

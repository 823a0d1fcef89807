"""Batches over a real HTTP/1.1 connection, by the real clock.

The requests of a batch are sent together (pipelined), so that its files share a round trip and arrive one after
another, as on the simulated link. What arrives is checked against the tables before it counts.
"""

from __future__ import annotations

import math
import select
import socket
import time
import urllib.request
from collections.abc import Callable
from dataclasses import dataclass, field
from urllib.parse import quote, urlsplit

from airgs_codec.errors import ConfigError, FormatError, TransportError
from airgs_codec.package.packing import MAX_ROOT_BYTES
from airgs_codec.package.parse import parse_root
from airgs_codec.package.paths import JSON_NAME, locate
from airgs_codec.package.store import check_digest, open_manifest
from airgs_codec.package.tables import PAGE, FileEntry
from airgs_codec.play.catalogue import Catalogue
from airgs_codec.play.downloader import CHECK_S, GiveUp, Partial
from airgs_codec.play.events import Arrival, Request
from airgs_codec.play.http_responses import Response, ResponseReader

TIMEOUT_S = 30.0  # without a byte: the link has failed
CHUNK_BYTES = 1 << 16
Receive = Callable[[str, bytes], None]


def open_catalogue(url: str, timeout_s: float = TIMEOUT_S) -> Catalogue:
    """The catalogue of the package at a URL, from its airgs.json; `HttpDownloader` adds the tables that it fetches.

    Raises TransportError, FormatError.
    """
    try:
        with urllib.request.urlopen(f"{url.rstrip('/')}/{JSON_NAME}", timeout=timeout_s) as response:
            data = response.read(MAX_ROOT_BYTES + 1)
    except OSError as error:
        raise TransportError(f"{url}: cannot read {JSON_NAME}: {error}") from error
    if len(data) > MAX_ROOT_BYTES:
        raise FormatError("too_large", f"{url}/{JSON_NAME}", f"expected at most {MAX_ROOT_BYTES} bytes")
    received: dict[str, bytes] = {}

    def read(path: str, entry: FileEntry) -> bytes:
        if path not in received:
            raise FormatError("missing_file", path, "it has not been fetched")
        return received[path]

    return Catalogue(open_manifest(parse_root(data), read), root_bytes=len(data), received=received)


def _discard(path: str, data: bytes) -> None:
    """Do nothing with a file."""


@dataclass(slots=True, eq=False)
class _Transfer:
    """A batch under way."""

    request: Request
    expected_bytes: int
    waiting: list[str]  # files still to come, in the order of their requests
    first_byte_s: float | None = None
    bytes: int = 0
    whole: list[str] = field(default_factory=list)
    refused: dict[str, FormatError] = field(default_factory=dict)
    looks: int = 0

    def next_look_s(self, now_s: float) -> float:
        """When the transfer is looked at next."""
        return now_s + CHECK_S if self.first_byte_s is None else self.first_byte_s + CHECK_S * (self.looks + 1)

    def partial(self, now_s: float) -> Partial:
        """What is known of it at a moment after its first byte."""
        return Partial(now_s, now_s - (self.first_byte_s or 0.0), float(self.bytes), self.expected_bytes)


class HttpDownloader:
    """Fetches a package from a server; `received` is given every file that came whole and is what the tables say.

    Time is seconds from the first request. Raises ConfigError for a URL that is not http.
    """

    pipelines = False  # batches follow each other: the player knows that one is over only when it is

    def __init__(self, url: str, catalogue: Catalogue, received: Receive = _discard) -> None:
        parts = urlsplit(url)
        if parts.scheme != "http" or not parts.hostname:
            raise ConfigError(f"URL: expected http://HOST[:PORT]/PATH, got {url}")
        self._url, self._folder = url, quote(parts.path.rstrip("/"), safe="/%")
        self._address = parts.hostname, parts.port or 80
        self._catalogue, self._received = catalogue, received
        self._socket: socket.socket | None = None
        self._zero: float | None = None  # of the clock
        self._rtt_s = math.inf

    @property
    def rtt_s(self) -> float:
        """The shortest wait for a first byte so far, in seconds; 0 before there is any."""
        return self._rtt_s if self._rtt_s < math.inf else 0.0

    def fetch(self, request: Request, give_up: GiveUp | None = None) -> Arrival:
        """See Downloader. Raises TransportError when the server cannot be reached, stays silent or is no HTTP/1.1."""
        time.sleep(max(0.0, request.sent_s - self._now_s()))
        files = list(request.batch.files)
        expected = self._catalogue.wire_bytes([self._catalogue.file_bytes(path) for path in files])
        transfer, abandoned = _Transfer(request, expected, files), False
        try:
            while transfer.waiting and not abandoned:
                abandoned = self._listen(self._ask(transfer), transfer, give_up)
        except OSError as error:
            self.close()
            raise TransportError(f"{self._url}: {error}") from error
        now_s = self._now_s()
        first_s = now_s if transfer.first_byte_s is None else transfer.first_byte_s
        size = max(1, transfer.bytes)
        return Arrival(request, first_s, now_s, size, tuple(transfer.whole), transfer.refused, abandoned)

    def close(self) -> None:
        """Close the connection; the next request opens another."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _now_s(self) -> float:
        self._zero = time.monotonic() if self._zero is None else self._zero
        return time.monotonic() - self._zero

    def _ask(self, transfer: _Transfer) -> socket.socket:
        """Send the requests of all files that are waited for."""
        if self._socket is not None and select.select([self._socket], [], [], 0.0)[0]:
            self.close()  # the server has ended a connection that was idle for too long
        if self._socket is None:
            self._socket = socket.create_connection(self._address, TIMEOUT_S)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        host = f"Host: {self._address[0]}:{self._address[1]}"
        lines = [f"GET {self._folder}/{path} HTTP/1.1\r\n{host}\r\n\r\n" for path in transfer.waiting]
        self._socket.sendall("".join(lines).encode("ascii"))
        return self._socket

    def _listen(self, connection: socket.socket, transfer: _Transfer, give_up: GiveUp | None) -> bool:
        """Take in answers until the batch is there or the server ends the connection; True: it is given up."""
        reader = ResponseReader(1 + max(self._catalogue.file_bytes(path) for path in transfer.waiting))
        asked_s = heard_s = self._now_s()
        count = len(transfer.waiting)
        while transfer.waiting:
            data = self._receive(connection, transfer.next_look_s(self._now_s()))
            now_s = self._now_s()
            if data:
                heard_s = now_s
                self._count(transfer, len(data), now_s - asked_s)
                for response in reader.feed(data):
                    self._judge(transfer, response)
            if reader.closed or data == b"":
                self.close()
                if len(transfer.waiting) == count:
                    raise TransportError(f"the server closed the connection with {count} files to come")
                return False
            if now_s - heard_s > TIMEOUT_S:
                raise TransportError(f"no answer for {TIMEOUT_S:g} s")
            if give_up and transfer.waiting and now_s >= transfer.next_look_s(now_s):
                transfer.looks += 1
                if give_up(transfer.partial(now_s)):
                    self.close()
                    return True
        return False

    def _receive(self, connection: socket.socket, until_s: float) -> bytes | None:
        """What has come, b"" at the end of the connection, None if nothing comes until then."""
        ready, _, _ = select.select([connection], [], [], max(0.0, until_s - self._now_s()))
        return connection.recv(CHUNK_BYTES) if ready else None

    def _count(self, transfer: _Transfer, size: int, waited_s: float) -> None:
        if transfer.first_byte_s is None:
            transfer.first_byte_s = self._now_s()
            self._rtt_s = min(self._rtt_s, waited_s)
        transfer.bytes += size

    def _judge(self, transfer: _Transfer, response: Response) -> None:
        """The oldest request is answered: keep the file if it is what the tables say."""
        path = transfer.waiting.pop(0)
        error = self._fault(path, response) or self._table_fault(path, response)
        if error is None:
            transfer.whole.append(path)
            self._received(path, bytes(response.body))
        else:
            transfer.refused[path] = error

    def _fault(self, path: str, response: Response) -> FormatError | None:
        """Why a file cannot be used, None if it can."""
        if response.status != 200:
            return FormatError("missing_file", path, f"expected a file, got status {response.status}")
        if path == JSON_NAME:
            return None
        entry = self._catalogue.manifest.entry(path)
        if response.length != entry.bytes:
            return FormatError("size_mismatch", path, f"expected {entry.bytes} bytes, got {response.length}")
        try:
            check_digest(path, response.body, entry)
        except FormatError as error:
            return error
        return None

    def _table_fault(self, path: str, response: Response) -> FormatError | None:
        """Add a page or a table to the catalogue. Why it cannot be read, None if it can, and for other files."""
        what, numbers = locate(path)
        groups = self._catalogue.manifest.groups
        if what not in ("group", "page"):
            return None
        self._catalogue.received[path] = bytes(response.body)
        try:
            if what == "group":
                groups[numbers[0] - 1]
            else:
                groups.places.entry(PAGE * (numbers[0] - 1))
        except FormatError as error:
            return error
        return None

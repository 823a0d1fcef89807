"""Reading HTTP/1.1 responses that follow one another on a connection, as their bytes come in (RFC 9112)."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass, field
from http.client import HTTPException, parse_headers

from airgs_codec.errors import TransportError

MAX_HEAD_BYTES = 1 << 16  # of status line and headers
HEAD_END = b"\r\n\r\n"


@dataclass(slots=True, eq=False)
class Response:
    """An answer whose head has come."""

    status: int
    length: int  # bytes of the body, from Content-Length
    closes: bool  # the server ends the connection after it
    body: bytearray = field(default_factory=bytearray)  # no more of it than the reader's limit
    left: int = 0  # bytes of the body still to come


class ResponseReader:
    """Splits a stream of bytes into responses. Of a body longer than `limit` bytes the rest is dropped."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._head = bytearray()
        self._open: Response | None = None
        self.closed = False  # by the last response

    def feed(self, data: bytes) -> Iterator[Response]:
        """Responses that are complete with these bytes. Raises TransportError for what is no such stream."""
        rest = data
        while rest or (self._open is not None and not self._open.left):
            rest = self._take_head(rest) if self._open is None else self._take_body(self._open, rest)
            if self._open is not None and not self._open.left:
                finished, self._open = self._open, None
                self.closed = finished.closes
                yield finished

    def _take_head(self, data: bytes) -> bytes:
        self._head += data
        end = self._head.find(HEAD_END)
        if end < 0:
            if len(self._head) > MAX_HEAD_BYTES:
                raise TransportError(f"expected at most {MAX_HEAD_BYTES} bytes of headers")
            return b""
        end += len(HEAD_END)
        head, rest = bytes(self._head[:end]), bytes(self._head[end:])
        self._head.clear()
        self._open = _parse_head(head)
        return rest

    def _take_body(self, response: Response, data: bytes) -> bytes:
        part, rest = data[: response.left], data[response.left :]
        response.body += part[: max(0, self._limit - len(response.body))]
        response.left -= len(part)
        return rest


def _parse_head(head: bytes) -> Response:
    stream = io.BytesIO(head)
    try:
        version, status, *_ = stream.readline().decode("latin-1").split(None, 2)
        headers = parse_headers(stream)
        length = int(headers["Content-Length"] or -1)
        if not version.startswith("HTTP/1.") or length < 0:
            raise ValueError("no Content-Length")
    except (ValueError, HTTPException) as error:
        raise TransportError(f"expected an HTTP/1.1 response with Content-Length, got {head[:80]!r}") from error
    connection = (headers["Connection"] or "").lower()
    closes = connection == "close" or (version == "HTTP/1.0" and connection != "keep-alive")
    return Response(int(status), length, closes, left=length)

"""The answer to a request for a file: conditions, ranges and content coding (RFC 9110)."""

from __future__ import annotations

import re
from collections.abc import Mapping

from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from airgs_codec.play.repr_digest import REPR_DIGEST, repr_digest
from airgs_codec.serve.files import Snapshot

LASTING = "public, max-age=31536000, immutable"
CHECKED = "no-cache"  # may be kept, but is asked for again each time
CHUNK_BYTES = 1 << 16  # given to a connection at once, so that a slow one holds little memory
_RANGE = re.compile(r"\s*bytes\s*=\s*(\d*)\s*-\s*(\d*)\s*", re.ASCII | re.IGNORECASE)
_DIGITS = 18  # of a position in a file; one with more lies behind every end


class Body(Response):
    """A response whose body is handed over in pieces, each when the connection has taken the one before."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send it (ASGI)."""
        await send({"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers})
        size = len(self.body)
        for start in range(0, max(1, size), CHUNK_BYTES):
            stop = start + CHUNK_BYTES
            piece = bytes(self.body[start:stop])
            await send({"type": "http.response.body", "body": piece, "more_body": stop < size})


def answer(snapshot: Snapshot, asked: Mapping[str, str]) -> Response:
    """The response to GET with the headers `asked` (names in lower case): 200, 206, 304 or 416.

    Several ranges in one request are answered with the whole file, as RFC 9110 section 14.2 allows.
    """
    zipped = None if "range" in asked or not _takes_gzip(asked) else snapshot.zipped
    data = snapshot.data if zipped is None else zipped
    tag = f'"{snapshot.sha256}"' if zipped is None else f'"{snapshot.sha256}-gzip"'
    headers = {"ETag": tag, "Cache-Control": LASTING if snapshot.lasting else CHECKED, "Accept-Ranges": "bytes"}
    if not snapshot.lasting:  # no table says what its bytes are
        headers[REPR_DIGEST] = repr_digest(bytes(data))
    if snapshot.zipped is not None:
        headers["Vary"] = "Accept-Encoding"
    if _is_known(asked.get("if-none-match", ""), tag):
        return Response(status_code=304, headers=headers)
    if zipped is not None:
        headers["Content-Encoding"] = "gzip"
    part = _part(asked, tag, len(data))
    if part is None:
        return Body(data, headers=headers, media_type=snapshot.media_type)
    if not part:
        return Response(status_code=416, headers={"Content-Range": f"bytes */{len(data)}"})
    headers["Content-Range"] = f"bytes {part.start}-{part.stop - 1}/{len(data)}"
    return Body(data[part.start : part.stop], 206, headers, snapshot.media_type)


def parse_range(text: str, size: int) -> range | None:
    """The bytes that a Range header asks for, of `size`: an empty range if there are none of them.

    None where the header is to be ignored: no range of bytes, or several.
    """
    match = _RANGE.fullmatch(text)
    if not match or not any(match.groups()):
        return None
    first, last = (_position(digits) for digits in match.groups())
    if first is None:  # the last so many bytes
        return range(max(0, size - (last or 0)), size)
    if last is not None and last < first:
        return None
    return range(min(first, size), size if last is None else min(last + 1, size))


def _position(digits: str) -> int | None:
    digits = digits.lstrip("0") or digits[:1]
    return (int(digits) if len(digits) <= _DIGITS else 10**_DIGITS) if digits else None


def _part(asked: Mapping[str, str], tag: str, size: int) -> range | None:
    if asked.get("if-range", tag) != tag:
        return None
    return parse_range(asked.get("range", ""), size)


def _is_known(header: str, tag: str) -> bool:
    """Whether If-None-Match names the tag; the comparison is the weak one, as it has to be."""
    return header.strip() == "*" or tag in (part.strip().removeprefix("W/") for part in header.split(","))


def _takes_gzip(asked: Mapping[str, str]) -> bool:
    for part in asked.get("accept-encoding", "").lower().split(","):
        coding, _, weight = part.partition(";")
        if coding.strip() == "gzip":
            return not re.fullmatch(r"\s*q\s*=\s*0(\.0*)?\s*", weight)
    return False

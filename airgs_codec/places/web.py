"""Addresses of web servers, and their answers in words: the same whoever reads a package over HTTP."""

from __future__ import annotations

WEB = ("http", "https")
BUSY = (429, 502, 503, 504)
SILENCE_S = 8.0  # without an answer, after which people are told
CIRCLE = "its redirects lead in a circle"
_KEY = "a key, such as stands in an address after the ?, may be missing or too old"
_HINTS = {401: "the server asks for a sign-in", 403: f"the server refuses: {_KEY}", 404: "the server has no such file"}


def split_query(address: str) -> tuple[str, str]:
    """What stands before the query of an address, without slashes at its end, and the query with its ?, "" for none."""
    before, mark, query = address.partition("?")
    return before if before.endswith("://") else before.rstrip("/"), mark + query


def status_words(status: int) -> str:
    """What is wrong with an answer that has a status other than 200."""
    hint = _HINTS.get(status, "the server is busy" if status in BUSY else "")
    return f"expected a file, got status {status}{hint and f' ({hint})'}"


def got_words(data: bytes, otherwise: str) -> str:
    """What came in place of a file: a web page, where it begins as one."""
    return "a web page" if data[:64].removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"<") else otherwise

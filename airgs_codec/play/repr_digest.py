"""The digest of a whole answer in its headers (RFC 9530): the only check of airgs.json, which no table leads to."""

from __future__ import annotations

import base64
import hashlib
import re

from airgs_codec.errors import FormatError

REPR_DIGEST = "Repr-Digest"
_SHA256 = re.compile(r"\bsha-256=:([A-Za-z0-9+/]+=*):", re.ASCII)


def repr_digest(data: bytes) -> str:
    """The value of the header for an answer with these bytes."""
    return repr_value(hashlib.sha256(data).digest())


def repr_value(sha256: bytes) -> str:
    """The value of the header for an answer with this SHA-256."""
    return f"sha-256=:{base64.b64encode(sha256).decode()}:"


def check_repr_digest(where: str, data: bytes, header: str) -> None:
    """Raise FormatError(hash_mismatch) for bytes that are not those of the header; one without SHA-256 says nothing."""
    if _SHA256.search(header) and repr_digest(data) not in header:
        raise FormatError("hash_mismatch", where, "the SHA-256 differs from the one in the headers of the answer")

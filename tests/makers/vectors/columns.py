"""Column files (FORMAT.md, section 7): the numbers in them, and files that must be refused."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from airgs_codec.coding.rangecoder import MOST, encode_columns
from tests.makers.vectors.text import Table, binary, wide

Columns = Sequence[tuple[Sequence[int], int]]
EDGES = [n for bits in range(63) for n in (2**bits - 1, 2**bits)] + [MOST]


def columns() -> dict[str, Columns]:
    rng = np.random.default_rng(15)
    skewed = (rng.exponential(1.0, 400) ** 3).astype(np.int64).tolist()
    random = rng.integers(0, MOST, 40).tolist()
    return {
        "no column": [],
        "columns of no numbers": [([], 0), ([], 1)],
        "one zero": [([0], 0)],
        "one zero of order 1": [([0], 1)],
        "the largest number": [([MOST], 0), ([MOST], 1)],
        "every bit length": [(EDGES, 0)],
        "every bit length, order 1": [(EDGES[::-1], 1)],
        "the sets of models of order 1": [([13, 14, 15, 16, 17, 15, 14, 14, 16, 16, 0, 15, 1, 15, 2] * 6, 1)],
        "zeros": [([0] * 20_000, 0), ([0] * 20_000, 1)],
        "a one after many zeros": [([0] * 5000 + [1] + [0] * 100 + [7, 7], 0)],
        "a zero after many ones": [([1] * 5000 + [0] + [1] * 100, 0), ([7] * 900 + [4], 1)],
        "changes before and after 60 decisions": [(([0] * 59 + [1]) * 2 + ([0] * 60 + [1]) * 2 + [0] * 61 + [1], 0)],
        "changes after many": [(([3] * 200 + [0] * 200) * 3, 1)],
        "many small numbers": [(skewed, 0), (skewed, 1)],
        "bits without a model": [(random, 0), (random[::-1], 1)],
        "columns begin with fresh models": [([5] * 50, 1), ([5] * 50, 1), ([5] * 50, 0), ([5] * 50, 0)],
        "bytes of 0 and 255 in between": [([2**40 - 1] * 30 + [2**40] * 30, 0)],
    }


def table() -> Table:
    """Cases to read, and cases to refuse as bad_sidecar while or after reading columns of those lengths."""
    good = [
        {"name": name, "data": binary(encode_columns([(np.array(v, np.int64), o) for v, o in case])), "columns": listed}
        for name, case in columns().items()
        for listed in [[{"order": order, "numbers": wide(values)} for values, order in case]]
    ]
    return {"cases": good, "refused": list(_refused())}


def _refused() -> list[dict[str, Any]]:
    values = np.arange(50)
    whole = encode_columns([(values, 0)])
    broken = {
        "no bytes": b"",
        "four bytes": bytes(4),
        "the last byte is missing": whole[:-1],
        "half of the file is missing": whole[: len(whole) // 2],
        "a byte of 0 too many": whole + b"\0",
        "a byte too many": whole + b"\7",
        "the first byte is 1": b"\1" + whole[1:],
        "x is not 0 at the end": whole[:-1] + bytes([whole[-1] ^ 1]),
    }
    columns = [{"order": 0, "count": 50}]
    more = {"name": "fewer numbers are asked for than are there", "data": binary(whole)}
    return [
        *({"name": name, "data": binary(data), "columns": columns} for name, data in broken.items()),
        more | {"columns": [{"order": 0, "count": 40}]},
    ]

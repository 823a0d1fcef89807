"""Column files (FORMAT.md, section 7): the numbers in them, and files that must be refused."""

from __future__ import annotations

import numpy as np

from airgs_codec.coding.rangecoder import encode_columns
from tests.makers.vectors.text import Table, binary
from tests.support.vectors import Case, cases, numbers


def table() -> Table:
    """Cases to read, and cases to refuse as bad_sidecar while or after reading columns of those lengths."""
    return {"cases": [case | {"data": _data(case)} for case in cases("columns")], "refused": _refused()}


def _data(case: Case) -> str:
    columns = [(np.array(numbers(one["numbers"]), np.int64), one["order"]) for one in case["columns"]]
    return binary(encode_columns(columns))


def _refused() -> list[Case]:
    whole = encode_columns([(np.arange(50), 0)])
    broken = {
        "no bytes": b"",
        "four bytes": bytes(4),
        "the last byte is missing": whole[:-1],
        "half of the file is missing": whole[: len(whole) // 2],
        "a byte of 0 too many": whole + b"\0",
        "a byte too many": whole + b"\7",
        "the first byte is 1": b"\1" + whole[1:],
        "x is not 0 at the end": whole[:-1] + bytes([whole[-1] ^ 1]),
        "fewer numbers are asked for than are there": whole,
    }
    return [
        {"name": name, "data": binary(data), "columns": [{"order": 0, "count": 40 if data == whole else 50}]}
        for name, data in broken.items()
    ]

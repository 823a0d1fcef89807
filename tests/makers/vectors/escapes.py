"""Escapes and the bases that they make (FORMAT.md, section 6)."""

from __future__ import annotations

import numpy as np

from airgs_codec.coding.rangecoder import encode_columns
from tests.makers.vectors.text import Table, binary
from tests.support.vectors import Case, cases, numbers

BROKEN = {  # each has two frames of one plane of three rows, six samples
    "more jumps than samples": (7, [0, 1, 1, 1, 1, 1, 1], [2] * 7),
    "very many jumps": (2**62, [], []),
    "two jumps of one sample": (2, [1, 0], [2, 2]),
    "a jump after the last sample": (2, [5, 1], [2, 2]),
    "a gap of 63 bits": (2, [0, 2**63 - 1], [2, 2]),
    "a jump of 32 bits": (1, [0], [2**32]),
    "fewer jumps than it says": (3, [0, 1], [2, 2]),
}


def table() -> Table:
    """Segments with the bases of every frame, and columns that must be refused."""
    size = {"frames": 2, "planes": 1, "rows": 3}
    refused = [{"name": name, **size, "data": _pack(*parts)} for name, parts in BROKEN.items()]
    return {"cases": [case | {"data": _data(case)} for case in cases("escapes")], "refused": refused}


def _data(case: Case) -> str:
    """The jumps that make the bases of a case, which are 0 before its first frame."""
    frames = [[number for line in frame for number in numbers(line)] for frame in case["bases"]]
    before = [[0] * len(frames[0]), *frames]
    jumps = [b - a for one, other in zip(before, frames, strict=False) for a, b in zip(one, other, strict=True)]
    index = [place for place, jump in enumerate(jumps) if jump]
    zigzag = [2 * jump if jump >= 0 else -2 * jump - 1 for jump in jumps if jump]
    return _pack(len(index), [b - a for a, b in zip([0, *index], index, strict=False)], zigzag)


def _pack(count: int, gaps: list[int], zigzag: list[int]) -> str:
    columns = (([count], 0), (gaps, 0), (zigzag, 1))
    return binary(encode_columns([(np.array(values, np.int64), order) for values, order in columns]))

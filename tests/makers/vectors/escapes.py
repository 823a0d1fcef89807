"""Escapes and the bases that they make (FORMAT.md, section 6)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from airgs_codec.coding.rangecoder import encode_columns
from tests.makers.vectors.text import Table, binary, runs

Shape = tuple[int, int, int]  # T, P, N
Jumps = Mapping[tuple[int, int, int], int]  # (frame, plane, row) -> by how much the base changes
MOST = 2**31 - 1


def cases() -> list[tuple[str, Shape, Jumps]]:
    rng = np.random.default_rng(6)
    places = rng.choice(5 * 3 * 40, 150, replace=False)
    sizes = rng.geometric(0.5, 150) * rng.choice([-1, 1], 150)
    many = {
        (int(t), int(p), int(i)): int(jump)
        for (t, p, i), jump in zip(np.transpose(np.unravel_index(places, (5, 3, 40))), sizes, strict=True)
    }
    return [
        ("no jumps", (2, 1, 3), {}),
        ("the first sample", (1, 1, 2), {(0, 0, 0): 1}),
        ("the last sample", (2, 2, 3), {(1, 1, 2): -1}),
        ("a base lasts until it jumps again", (4, 2, 2), {(1, 0, 1): 2, (3, 0, 1): -3, (1, 1, 0): 1}),
        ("every sample", (2, 2, 2), {index: 1 - 2 * (sum(index) % 2) for index in np.ndindex(2, 2, 2)}),
        ("the largest jumps", (2, 1, 4), {(0, 0, 0): MOST, (1, 0, 0): -MOST, (0, 0, 2): -MOST - 1, (1, 0, 2): 2**30}),
        ("many", (5, 3, 40), many),
    ]


def table() -> Table:
    """Segments with the bases of every frame, and columns that must be refused."""
    return {"cases": [_case(*case) for case in cases()], "refused": _refused()}


def _case(name: str, shape: Shape, jumps: Jumps) -> dict[str, Any]:
    _, planes, rows = shape
    flat = sorted(((t * planes + p) * rows + i, jump) for (t, p, i), jump in jumps.items())
    index = [place for place, _ in flat]
    zigzag = [2 * jump if jump >= 0 else -2 * jump - 1 for _, jump in flat]
    gaps = [after - before for before, after in zip([0, *index], index, strict=False)]
    base = [[0] * rows for _ in range(planes)]
    frames = []
    for t in range(shape[0]):
        base = [[number + jumps.get((t, p, i), 0) for i, number in enumerate(line)] for p, line in enumerate(base)]
        frames.append(base)
    data = _pack(len(flat), gaps, zigzag)
    return {
        "name": name,
        "frames": shape[0],
        "planes": planes,
        "rows": rows,
        "data": data,
        "bases": [[runs(line) for line in frame] for frame in frames],
    }


def _pack(count: int, gaps: list[int], zigzag: list[int]) -> str:
    columns = (([count], 0), (gaps, 0), (zigzag, 1))
    return binary(encode_columns([(np.array(values, np.int64), order) for values, order in columns]))


def _refused() -> list[dict[str, Any]]:
    """Each has two frames of one plane of three rows, six samples."""
    broken = {
        "more jumps than samples": (7, [0, 1, 1, 1, 1, 1, 1], [2] * 7),
        "very many jumps": (2**62, [], []),
        "two jumps of one sample": (2, [1, 0], [2, 2]),
        "a jump after the last sample": (2, [5, 1], [2, 2]),
        "a gap of 63 bits": (2, [0, 2**63 - 1], [2, 2]),
        "a jump of 32 bits": (1, [0], [2**32]),
        "fewer jumps than it says": (3, [0, 1], [2, 2]),
    }
    size = {"frames": 2, "planes": 1, "rows": 3}
    return [{"name": name, **size, "data": _pack(*parts)} for name, parts in broken.items()]

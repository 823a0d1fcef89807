"""Codes of a key -> values of the canonical space (FORMAT.md, sections 4 and 5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from airgs_codec.package.tables import Grid
from tests.makers.vectors.formulas import Coding, Steps, key_row, listed, pack_transform
from tests.makers.vectors.positions import ANY
from tests.makers.vectors.text import Table

STEPS = {"quaternions": 0.025, "log_scales": 0.08, "opacity": 0.014, "sh_dc": 0.036, "sh_rest": 0.04}
COLOURS = (3, 12, 27, 48)  # channels, by SH degree
Codes = list[list[int]]  # one list a row


def rotated(side: int, rng: np.random.Generator) -> list[list[float]]:
    """Some rotation of `side` dimensions, row by row; a product of plane rotations, so that no library decides it."""
    matrix = [[float(i == j) for j in range(side)] for i in range(side)]
    for a, b in zip(rng.permutation(side).tolist(), rng.permutation(side).tolist(), strict=True):
        if a != b:
            matrix[a], matrix[b] = (
                [0.8 * x + 0.6 * y for x, y in zip(matrix[a], matrix[b], strict=True)],
                [0.8 * y - 0.6 * x for x, y in zip(matrix[a], matrix[b], strict=True)],
            )
    return matrix


def drawn(rows: int, channels: int, rng: np.random.Generator, spread: float = 30.0) -> Codes:
    return [[round(c) for c in line] for line in rng.normal(0, spread, (rows, channels)).tolist()]


def table() -> Table:
    rng = np.random.default_rng(5)
    plain = [
        _case(f"SH degree {degree}", degree, drawn(4, 7 + c, rng), rng=rng, factor=(1.0, 1.5, 2.0, 3.7)[degree])
        for degree, c in enumerate(COLOURS)
    ]
    turns = [[0, 0, 0], [1, 0, 0], [0, -126, 0], [0, 0, 251], [252, 252, 0], [-400, 300, 200], [5000, 0, 1]]
    return {
        "cases": [
            *plain,
            _case("all codes 0", 0, [[0] * 10], rng=rng),
            _case("sizes in another unit", 0, [[0] * 10, [99] * 10], rng=rng, grid=Grid([0, 0, 0], 0.003, -7)),
            _case("large codes", 0, [[2**24 + 1] * 3 + [0] * 7, [-(2**30)] * 3 + [0] * 4 + [2**20] * 3], rng=rng),
            _case("turns about 0, π, 2π and more", 0, [[0] * 3 + turn + [0] * 4 for turn in turns], rng=rng),
            _case("tiny turns", 0, [[0] * 3 + [1, 2, -2] + [0] * 4], rng=rng, steps=STEPS | {"quaternions": 1e-12}),
            _case("alpha outside of 0 to 1", 0, [[0] * 6 + [a] + [0] * 3 for a in (-20, 0, 1, 428, 429, 500)], rng=rng),
        ]
    }


def _case(
    name: str,
    degree: int,
    codes: Codes,
    *,
    rng: np.random.Generator,
    factor: float = 1.0,
    steps: Steps = STEPS,
    grid: Grid = ANY,
) -> dict[str, Any]:
    text, transform = pack_transform(rotated(COLOURS[degree], rng))
    coding = Coding(steps, factor, 6.0, transform, grid.unit)
    expected: dict[str, Any] = listed([key_row(row, coding) for row in codes], limit=False)
    for part in expected.values():
        part.pop("means")
    return {
        "name": name,
        "sh_degree": degree,
        "steps": steps,
        "grid": asdict(grid),
        "factor": factor,
        "gain": coding.gain,
        "colour_transform": text,
        "codes": by_channel(codes),
        **expected,
    }


def by_channel(codes: Sequence[Sequence[int]]) -> Codes:
    return [list(line) for line in zip(*codes, strict=True)]

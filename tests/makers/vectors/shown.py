"""What rows look like: their covariance, and their colour from a direction (FORMAT.md, section 5, "What is shown")."""

from __future__ import annotations

import math

from tests.makers.vectors.text import Table, plain
from tests.support.vectors import Case, cases


def basis(x: float, y: float, z: float) -> list[float]:
    """The real spherical harmonics of bands 0 to 3, from their closed forms."""
    pi = math.pi
    one, two, three = math.sqrt(3 / (4 * pi)), math.sqrt(15 / (4 * pi)), math.sqrt(35 / (32 * pi))
    return [
        math.sqrt(1 / (4 * pi)),
        *(-one * y, one * z, -one * x),
        *(two * x * y, -two * y * z, math.sqrt(5 / (16 * pi)) * (2 * z * z - x * x - y * y)),
        *(-two * x * z, two / 2 * (x * x - y * y)),
        *(-three * y * (3 * x * x - y * y), math.sqrt(105 / (4 * pi)) * x * y * z),
        -math.sqrt(21 / (32 * pi)) * y * (4 * z * z - x * x - y * y),
        math.sqrt(7 / (16 * pi)) * z * (2 * z * z - 3 * x * x - 3 * y * y),
        -math.sqrt(21 / (32 * pi)) * x * (4 * z * z - x * x - y * y),
        *(math.sqrt(105 / (16 * pi)) * z * (x * x - y * y), -three * x * (x * x - 3 * y * y)),
    ]


def table() -> Table:
    """Covariances of rows; colours of coefficients, r g b of each, from directions."""
    return {
        "covariances": [case | {"covariance": _covariance(case)} for case in cases("shown", "covariances")],
        "colours": [case | {"colour": _colour(case)} for case in cases("shown", "colours")],
    }


def _covariance(case: Case) -> list[list[float]]:
    w, x, y, z = case["quaternion"]
    matrix = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    squares = [math.exp(2 * size) for size in case["log_scales"]]
    product = [[math.fsum(a * s * b for a, s, b in zip(i, squares, j, strict=True)) for j in matrix] for i in matrix]
    return plain(product)


def _colour(case: Case) -> list[float]:
    rows = case["coefficients"]
    weights = basis(*case["direction"])[: len(rows)]
    sums = [0.5 + math.fsum(w * row[i] for w, row in zip(weights, rows, strict=True)) for i in range(3)]
    return plain([max(0.0, one) for one in sums])

"""What rows look like: their covariance, and their colour from a direction (FORMAT.md, section 5, "What is shown")."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from tests.makers.vectors.formulas import rotation
from tests.makers.vectors.text import Table, plain

DIRECTIONS = [
    (1.0, 0.0, 0.0),
    (0.0, 1.0, 0.0),
    (0.0, 0.0, 1.0),
    (0.6, -0.8, 0.0),
    (2 / 7, 3 / 7, 6 / 7),
    (-2 / 3, -1 / 3, 2 / 3),
]


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
    rng = np.random.default_rng(9)
    coefficients = [(np.round(rng.normal(0, 0.4, (bands**2, 3)) * 1024) / 1024).tolist() for bands in (1, 2, 3, 4)]
    turns = [(0.0, 0.0, 0.0), (0.0, 0.0, 1.5), (2.0, -1.0, 0.5)]
    sizes = [(0.0, 0.0, 0.0), (0.5, -1.0, -3.0)]
    return {
        "covariances": [_covariance(turn, size) for turn in turns for size in sizes],
        "colours": [_colour(degree, sh, d) for degree, sh in enumerate(coefficients) for d in DIRECTIONS],
    }


def _covariance(turn: Sequence[float], log_scales: Sequence[float]) -> dict[str, Any]:
    w, x, y, z = rotation(turn).quaternion
    matrix = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    squares = [math.exp(2 * size) for size in log_scales]
    product = [[math.fsum(a * s * b for a, s, b in zip(i, squares, j, strict=True)) for j in matrix] for i in matrix]
    quaternion = plain((w, x, y, z))
    return {"quaternion": quaternion, "log_scales": log_scales, "covariance": plain(product), "tolerance": 1e-5}


def _colour(degree: int, sh: list[list[float]], direction: tuple[float, float, float]) -> dict[str, Any]:
    weights = basis(*direction)[: len(sh)]
    colour = [max(0.0, 0.5 + math.fsum(w * row[i] for w, row in zip(weights, sh, strict=True))) for i in range(3)]
    case = {"sh_degree": degree, "coefficients": sh, "direction": plain(direction)}
    return {**case, "colour": plain(colour), "tolerance": 1e-5}

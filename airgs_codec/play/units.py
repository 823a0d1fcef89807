"""Key units: what is fetched and decoded once for a group. A unit is a key tier of a tile."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

KeyUnits = frozenset[tuple[int, int]]  # (key quality, number) of those units of a group that are decoded
Tiles = frozenset[int]
NONE: KeyUnits = frozenset()


def absent(units: KeyUnits, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """(Q, K) units that are not decoded, of Q key qualities."""
    missing = np.ones(shape, np.bool_)
    for unit in units:
        missing[unit] = False
    return missing

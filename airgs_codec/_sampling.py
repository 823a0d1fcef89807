"""A few of many, evenly."""

from __future__ import annotations

import numpy as np


def evenly_spaced(count: int, most: int) -> list[int]:
    """At most `most` of 0 .. count - 1, ascending, first and last among them (the first alone if `most` is 1)."""
    picks: list[int] = np.unique(np.linspace(0, count - 1, min(most, count)).round().astype(int)).tolist()
    return picks

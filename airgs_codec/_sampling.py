"""A few of many, evenly spaced: views, blocks of rows, frames."""

from __future__ import annotations

import numpy as np


def evenly_spaced(count: int, most: int) -> list[int]:
    """At most `most` of 0 .. count - 1, ascending, first and last among them (the first alone if `most` is 1)."""
    picks: list[int] = np.unique(np.linspace(0, count - 1, min(most, count)).round().astype(int)).tolist()
    return picks


GOLDEN = (5**0.5 - 1) / 2  # turns by it spread evenly


def middle_frames(start: int, stop: int, most: int, turn: int = 0) -> list[int]:
    """At most `most` frames of [start, stop), ascending, each in an equal part; in its middle in turn 0.

    The first and last frames of a segment would be the furthest from the canonical frame, and make it look worse than
    it is. Later turns take other places of the parts, so that no frame is left out for ever.
    """
    parts = min(most, stop - start)
    at = (0.5 + turn * GOLDEN) % 1
    return [start + int((i + at) * (stop - start) / parts) for i in range(parts)]

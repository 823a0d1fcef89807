"""A few of many, evenly spaced: views, blocks of rows, frames."""

from __future__ import annotations

import numpy as np


def evenly_spaced(count: int, most: int) -> list[int]:
    """Return at most `most` of 0 .. count - 1, ascending, with the first and, if `most` is above 1, the last."""
    picks: list[int] = np.unique(np.linspace(0, count - 1, min(most, count)).round().astype(int)).tolist()
    return picks


def middle_frames(start: int, stop: int, most: int) -> list[int]:
    """Return at most `most` frames of [start, stop), ascending, each in the middle of an equal part.

    The first and last frames of a segment are the furthest from the canonical frame and make it look worse.
    """
    parts = min(most, stop - start)
    return [start + int((i + 0.5) * (stop - start) / parts) for i in range(parts)]

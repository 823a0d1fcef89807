"""Display ticks: what is on the screen every 1 / fps seconds from the first picture on, also while the player waits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from airgs_codec.play.events import Shown


def screen_ticks(shown: Sequence[Shown], fps: float) -> list[tuple[int, int]]:
    """For every display tick (1 / fps) from the first picture on: which entry of `shown`, which frame of it.

    While the player waits, the last frame stays.
    """
    ticks: list[tuple[int, int]] = []
    for i, entry in enumerate(shown):
        if i:
            ticks += [(i - 1, shown[i - 1].frames - 1)] * round(entry.stall_s * fps)
        ticks += [(i, frame) for frame in range(entry.frames)]
    return ticks


def tick_times(shown: Sequence[Shown], fps: float) -> NDArray[np.float64]:
    """Seconds from the first request to every display tick."""
    times: list[float] = []
    for i, entry in enumerate(shown):
        if i:
            times += [entry.start_s - entry.stall_s + tick / fps for tick in range(round(entry.stall_s * fps))]
        times += [entry.start_s + frame / fps for frame in range(entry.frames)]
    return np.array(times)

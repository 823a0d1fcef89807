"""Whether one way is better than another, paired over links, views or seeds: what may be chance is not said."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from airgs_codec.play.study import NONE, interval


class Difference(NamedTuple):
    mean: float
    low: float  # 95 % from here
    high: float
    sign: int  # 1: more, -1: less, 0: not beyond its error, or of too few pairs

    def words(self, unit: str, more: str = "better", less: str = "worse") -> str:
        if not self.sign:
            return f"{NONE.lower()} ({self.low:.2f} to {self.high:.2f} {unit})"
        low, high = sorted(abs(v) for v in (self.low, self.high))
        return f"{abs(self.mean):.2f} {unit} {more if self.sign > 0 else less} ({low:.2f} to {high:.2f})"


def difference(mine: Sequence[float], other: Sequence[float], groups: Sequence[str] = ()) -> Difference:
    """How much more `mine` are than `other`, pair by pair; pairs of one group are not independent of each other."""
    groups = groups or [str(i) for i in range(len(mine))]
    found = interval(np.asarray(mine, np.float64) - np.asarray(other, np.float64), groups)
    return Difference(*found, found.sign(groups))

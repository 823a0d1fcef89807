"""What a format can hold of Gaussians: how a frame is made to fit, and what that loses, in words."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.repair import repair

_WORDS = {"means": "positions", "log_scales": "sizes", "sh_dc": "colours", "sh_rest": "SH"}


@dataclass(frozen=True, slots=True)
class Holds:
    """What files of a format hold; without any word of it, all that Gaussians have, in float32."""

    sh_degree: int = 3
    rounding: str = ""  # what is rounded to how many bits
    keeps_rows: bool = True  # whether row n is the same Gaussian in all frames
    keeps_count: bool = False  # whether all frames have the same number of rows
    ranges: tuple[tuple[str, float, float], ...] = ()  # an attribute of Gaussians, its least and largest value


class Losses:
    """What is lost of the frames that were made to fit a format."""

    def __init__(self, holds: Holds, form: str) -> None:
        self._holds, self._form = holds, form
        self._rows: list[int] = []  # of each frame
        self._degree = 0
        self._beyond: Counter[str] = Counter()
        self._notes: list[str] = []

    def fit(self, gaussians: Gaussians, where: str) -> Gaussians:
        """The frame as the format can hold it: unit quaternions, no SH above its degree, values within its ranges.

        Raises SceneError, which names the frame by `where`, when no Gaussian is finite.
        """
        repaired = repair([gaussians], where)
        g = repaired.frames[0]
        self._notes += repaired.notes
        self._rows.append(len(g))
        self._degree = max(self._degree, g.sh_degree)
        g = g.with_degree(min(g.sh_degree, self._holds.sh_degree))
        for name, low, high in self._holds.ranges:
            values = getattr(g, name)
            beyond = ((values < low) | (values > high)).reshape(len(g), -1).any(axis=1)
            if beyond.any():
                self._beyond[name] += int(beyond.sum())
                g = replace(g, **{name: np.clip(values, np.float32(low), np.float32(high))})
        return g

    def lines(self) -> list[str]:
        """What was lost, a line for each kind; empty where nothing was."""
        lines = list(self._notes)
        if self._degree > self._holds.sh_degree:
            lines.append(f"{self._form} has SH of degree {self._holds.sh_degree} at most, of {self._degree}")
        if self._holds.rounding:
            lines.append(f"{self._form} rounds {self._holds.rounding}")
        if not self._holds.keeps_rows and len(self._rows) > 1:
            lines.append(f"{self._form} has rows in another order in every frame: which Gaussian is which is lost")
        if self._holds.keeps_count and len(set(self._rows)) > 1:
            lines.append(f"{self._form} has {max(self._rows)} rows in every frame: the shorter end in some of alpha 0")
        for name, low, high in self._holds.ranges:
            if count := self._beyond[name]:
                share = f"{count} of {sum(self._rows)} Gaussians"
                lines.append(f"{self._form} has {_WORDS[name]} from {low:.4g} to {high:.4g}: cut off in {share}")
        return lines

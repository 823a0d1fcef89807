"""Memory of frames that nobody has any more, for the next frames.

Fresh memory of the size of a large frame comes from the system, which clears it page by page: a third of the time of a
decoded frame of a million Gaussians.
"""

from __future__ import annotations

import sys

import numpy as np
from numpy.typing import NDArray

_OURS = 3  # references to an array that nobody else has: of the list, of the loop, and of the count itself


class FrameMemory:
    """Gives out arrays, each anew once the one who got it has let go of it and of all views of it."""

    def __init__(self) -> None:
        self._arrays: list[NDArray[np.float32]] = []

    def empty_like(self, like: NDArray[np.float32]) -> NDArray[np.float32]:
        """An array of the shape of `like` with any content, which nobody else has."""
        for array in self._arrays:
            if array.shape == like.shape and sys.getrefcount(array) == _OURS:
                return array
        self._arrays.append(np.empty_like(like))
        return self._arrays[-1]

"""Memory of frames that nobody has any more, for the next frames.

Fresh memory of the size of a large frame comes from the system, which clears it page by page: a third of the time of a
decoded frame of a million Gaussians.
"""

from __future__ import annotations

import sys

import numpy as np
from numpy.typing import NDArray


def _references(arrays: list[NDArray[np.float32]]) -> list[int]:
    """How often each array is held, by whatever this version of Python counts here besides."""
    return [sys.getrefcount(array) for array in arrays]


_OURS = _references([np.empty(0, np.float32)])[0]  # of an array that nobody has but the list


class FrameMemory:
    """Gives out arrays, each anew once the one who got it has let go of it and of all views of it."""

    def __init__(self) -> None:
        self._arrays: list[NDArray[np.float32]] = []

    def empty_like(self, like: NDArray[np.float32]) -> NDArray[np.float32]:
        """An array of the shape of `like` with any content, which nobody else has."""
        for array, held in zip(self._arrays, _references(self._arrays), strict=True):
            if array.shape == like.shape and held <= _OURS:
                return array
        self._arrays.append(np.empty_like(like))
        return self._arrays[-1]

"""Morton (Z-order) codes in three dimensions. M codes of up to 63 bits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Each step moves the bits of a 21-bit number further apart: shift, then keep the bits of the mask.
_SPREAD = (
    (32, 0x001F00000000FFFF),
    (16, 0x001F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)
_LOW_21 = np.uint64(0x1FFFFF)


def morton_encode(index: NDArray[np.integer]) -> NDArray[np.uint64]:
    """(M, 3) grid indices of at most 21 bits -> (M,) codes with bit 3b + axis = bit b of that axis."""
    code = np.zeros(len(index), np.uint64)
    for axis in range(3):
        v = index[:, axis].astype(np.uint64)
        for shift, mask in _SPREAD:
            v = (v | (v << np.uint64(shift))) & np.uint64(mask)
        code |= v << np.uint64(axis)
    return code


def morton_decode(code: NDArray[np.uint64]) -> NDArray[np.uint32]:
    """Inverse of `morton_encode`: (M,) codes -> (M, 3) grid indices."""
    index = np.empty((len(code), 3), np.uint32)
    for axis in range(3):
        v = (code >> np.uint64(axis)) & np.uint64(_SPREAD[-1][1])
        for (shift, _), mask in zip(reversed(_SPREAD), [m for _, m in reversed(_SPREAD[:-1])] + [_LOW_21], strict=True):
            v = (v | (v >> np.uint64(shift))) & np.uint64(mask)
        index[:, axis] = v
    return index

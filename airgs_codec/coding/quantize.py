"""Uniform quantisation: values <-> whole codes, `gain` codes a step. T frames, C channels, N rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError

CODE_LIMIT = 1 << 30  # |code| stays below it, so that sums of a code, a centre and a base fit int32
STEP_LIMITS = (1e-30, 1e30)  # of steps: products of codes and steps are float32


def to_codes(values: NDArray[np.float64], steps: NDArray[np.float64], gain: float, first: int = 0) -> NDArray[np.int32]:
    """(T, C, N) values, (C,) steps -> (T, C, N) codes; `from_codes` is at most step / (2 gain) off.

    `first` is the number of the first channel, for errors. Raises SceneError for a value 2^30 codes or more from 0,
    since nothing is clipped, and for a step that is not within STEP_LIMITS.
    """
    low, high = STEP_LIMITS
    if not ((steps >= low) & (steps <= high)).all():
        channel = int(np.argmin((steps >= low) & (steps <= high)))
        raise SceneError(f"channel {first + channel}: expected a step of {low:g} to {high:g}, got {steps[channel]:g}")
    codes = values * (gain / steps)[:, None]
    np.rint(codes, out=codes)
    if codes.size and not max(-codes.min(), codes.max()) < CODE_LIMIT:
        channel = int(np.unravel_index(np.abs(codes).argmax(), codes.shape)[1])
        largest = float(np.abs(values[:, channel]).max())
        got = f"value {largest:g} at step {steps[channel]:g}"
        raise SceneError(f"channel {first + channel}: expected at most {CODE_LIMIT} codes, got {got}")
    return codes.astype(np.int32)


def from_codes(codes: NDArray[np.int32], steps: NDArray[np.float64], gain: float) -> NDArray[np.float32]:
    """(C, N) codes, (C,) steps -> (C, N) values."""
    values = codes.astype(np.float32)
    values *= (steps / gain).astype(np.float32)[:, None]
    return values

"""Frame rates and durations as people write them."""

from __future__ import annotations

from fractions import Fraction

from airgs_codec.errors import SceneError

DEFAULT_FPS = Fraction(30)
MAX_FPS = 1000


def exact_number(text: str) -> Fraction:
    """A number: 30, 29.97 or 30000/1001. Raises ValueError or ZeroDivisionError.

    Powers of ten go through float64 and end at its largest: Fraction would write out all digits of 1e30000000.
    """
    return Fraction(text) if "/" in text else Fraction(str(float(text)))


def frame_rate(where: str, fps: Fraction | float) -> Fraction:
    """Frames a second, exactly. Raises SceneError where they are not above 0 and at most MAX_FPS."""
    if not 0 < fps <= MAX_FPS:
        raise SceneError(f"{where}: expected 0 < fps <= {MAX_FPS}, got {fps}")
    return Fraction(str(fps))  # 29.97 is 2997/100, not the nearest float

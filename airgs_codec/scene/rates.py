"""Frame rates and durations as people write them."""

from __future__ import annotations

from fractions import Fraction


def exact_number(text: str) -> Fraction:
    """A number: 30, 29.97 or 30000/1001. Raises ValueError or ZeroDivisionError.

    Powers of ten go through float64 and end at its largest: Fraction would write out all digits of 1e30000000.
    """
    return Fraction(text) if "/" in text else Fraction(str(float(text)))

"""What an atlas may be off by: the largest error of each attribute, codec included, in the units of its channels.

A sample that was sent as code c for value v, |v - c s| <= s / 2 with s = step * factor / gain, and decoded d luma
levels off, is off by at most (1/2 + d) s. Codes stay whole numbers through the decoder, and two roundings to float32
(code * s) add at most ROUNDING of the value. T frames, P planes, n rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from decimal import ROUND_CEILING, Decimal

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.atlas import extract
from airgs_codec.package.layout import Layout
from airgs_codec.package.tables import Atlas

ROUNDING = 2.0**-22
DIGITS = 3  # of a bound, which is rounded up to them


@dataclass(frozen=True, slots=True, eq=False)
class ErrorModel:
    """What is known of the errors of an atlas before its pictures are decoded."""

    units: NDArray[np.float64]  # (channels,) s, what a code counts
    largest: NDArray[np.float64]  # (channels,) largest |value|
    constant: NDArray[np.float64]  # (channels,) error of the channels without a plane, 0 of the others

    @staticmethod
    def of(low: NDArray[np.float64], high: NDArray[np.float64], atlas: Atlas, units: NDArray[np.float64]) -> ErrorModel:
        """From (channels,) least and largest values that the atlas was made of and the units of its codes."""
        centres = np.array(atlas.centres, np.float64) * units
        constant = np.maximum(np.abs(low - centres), np.abs(high - centres))
        constant[atlas.planes] = 0
        return ErrorModel(units, np.maximum(np.abs(low), np.abs(high)), constant)

    def bound(self, atlas: Atlas, differences: Sequence[NDArray[np.uint8]], layout: Layout) -> list[float]:
        """Largest error of each attribute of `layout`.

        `differences` are the (H, W) largest luma errors of the pictures of every closed GOP of the atlas.
        """
        errors = self.constant.copy()
        off = np.zeros(len(atlas.planes))
        for picture in differences:
            off = np.maximum(off, extract(picture, atlas).max(axis=1))
        errors[atlas.planes] = (0.5 + off) * self.units[atlas.planes]
        return _by_attribute(errors + ROUNDING * self.largest, layout)


def _by_attribute(errors: NDArray[np.float64], layout: Layout) -> list[float]:
    """The largest error of each attribute, of (channels,) errors."""
    places = layout.attribute_index(len(errors))
    return [_round_up(errors[places == k].max()) for k in range(int(places.max()) + 1)]


def widen(atlas: Atlas, errors: NDArray[np.float64], layout: Layout) -> Atlas:
    """The atlas with bounds that also hold for (channels,) errors of rows that it does not carry."""
    bounds = _by_attribute(errors, layout)
    return replace(atlas, max_error=[max(pair) for pair in zip(atlas.max_error, bounds, strict=True)])


def _round_up(error: float) -> float:
    """The least number of DIGITS significant digits that is no less."""
    shown = Decimal(float(error))
    return float(shown.quantize(Decimal(1).scaleb(shown.adjusted() - DIGITS + 1), ROUND_CEILING)) if error else 0.0


def with_bounds(
    atlas: Atlas, error: ErrorModel | None, differences: Sequence[NDArray[np.uint8]], layout: Layout
) -> Atlas:
    """The atlas with its `max_error`; zeros where nothing of it is sent, so that there is no error to speak of."""
    if error is None or not differences:
        return replace(atlas, max_error=[0.0] * len(layout.attributes))
    return replace(atlas, max_error=error.bound(atlas, differences, layout))

"""What an atlas may be off by: the largest error of each attribute, codec included. In the units of its channels.

A sample that was sent as code c for value v, |v - c s| <= s / 2 with s = step * factor / gain, and decoded d luma
levels off, is off by at most (1/2 + d) s. Codes stay whole numbers through the decoder, and two roundings to float32
(code * s) add at most ROUNDING of the value.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.atlas import extract
from airgs_codec.package.layout import KEY, STATE
from airgs_codec.package.tables import Atlas

ROUNDING = 2.0**-22


def attribute_of(channels: int, state: bool) -> NDArray[np.intp]:
    """(channels,) place of each channel's attribute in KEY.attributes or STATE.attributes."""
    fixed = [0, 0, 0] + ([1, 1, 1] if state else []) + [1 + state] * 3 + [2 + state]
    return np.array(fixed + [3 + state] * (channels - len(fixed)))


@dataclass(frozen=True, slots=True, eq=False)
class Sent:
    """What is known of an atlas before its pictures are decoded."""

    units: NDArray[np.float64]  # (channels,) s, what a code counts
    largest: NDArray[np.float64]  # (channels,) largest |value|
    constant: NDArray[np.float64]  # (channels,) error of the channels without a plane, 0 of the others

    @staticmethod
    def of(values: NDArray[np.float64], atlas: Atlas, units: NDArray[np.float64]) -> Sent:
        """From (T, channels, n) values."""
        centres = np.array(atlas.centres, np.float64) * units
        constant = np.abs(values - centres[:, None]).max(axis=(0, 2))
        constant[atlas.planes] = 0
        return Sent(units, np.abs(values).max(axis=(0, 2)), constant)


def max_error(atlas: Atlas, sent: Sent, differences: list[NDArray[np.uint8]], state: bool) -> list[float]:
    """For each attribute; `differences` are (H, W) pictures of the largest luma error over each closed GOP."""
    errors = sent.constant.copy()
    off = np.zeros(len(atlas.planes))
    for picture in differences:
        off = np.maximum(off, extract(picture, atlas).max(axis=1))
    errors[atlas.planes] = (0.5 + off) * sent.units[atlas.planes]
    errors += ROUNDING * sent.largest
    places = (STATE if state else KEY).attribute_index(len(errors))
    return [float(f"{errors[places == k].max() * 1.0006:.4g}") for k in range(int(places.max()) + 1)]

"""Colours and the KLT that decorrelates them. N rows, K SH coefficients past DC, C = 3 (1 + K) colour channels.

A colour is the SH coefficients of a row; it is transformed in units of its steps. Every function has its inverse beside
it. The encoder works in float64, the decoder in float32.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airgs_codec.package.tables import KeySteps, pack_matrix
from airgs_codec.scene.gaussians import Gaussians

Floats = NDArray[np.floating]


def colours(sh_dc: Floats, sh_rest: Floats) -> Floats:
    """(..., N, 3) and (..., N, K, 3) -> (..., N, C): DC r g b, then each SH rest coefficient r g b."""
    return np.concatenate([sh_dc, sh_rest.reshape(*sh_rest.shape[:-2], -1)], axis=-1)


def split_colours(channels: Floats) -> tuple[Floats, Floats]:
    """Inverse of `colours`: (..., N, C) -> (..., N, 3) and (..., N, K, 3)."""
    rest = channels[..., 3:]
    return channels[..., :3], rest.reshape(*rest.shape[:-1], rest.shape[-1] // 3, 3)


def colour_steps(sh_dc: float, sh_rest: float, channels: int) -> NDArray[np.float64]:
    """(C,) step of each colour channel before the KLT, from those of SH DC and SH rest; after it every step is 1."""
    return np.where(np.arange(channels) < 3, sh_dc, sh_rest)


def fit_colour_transform(scaled: NDArray[np.float64]) -> NDArray[np.float64]:
    """The orthonormal KLT (C, C) of (N, C) colours in units of their steps: row k is the k-th strongest direction.

    The entry of a row that is largest by size is positive, so that equal scenes give equal packages.
    """
    centred = scaled - scaled.mean(axis=0)
    _, vectors = np.linalg.eigh(centred.T @ centred)
    rows = vectors.T[::-1]
    strongest = np.take_along_axis(rows, np.abs(rows).argmax(axis=1)[:, None], axis=1)
    return rows * np.where(strongest < 0, -1.0, 1.0)


def to_klt(scaled: NDArray[np.float64], transform: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., C) colours in units of their steps -> KLT channels.

    The exact inverse of `from_klt`: the stored transform is rounded, so it is inverted, not transposed.
    """
    return scaled @ np.linalg.inv(transform)


def from_klt(channels: Floats, transform: Floats) -> Floats:
    """(..., C) KLT channels -> colours in units of their steps."""
    return channels @ transform


def colour_transform(key: Gaussians, steps: KeySteps) -> str:
    """The KLT of the colours of a canonical frame, as the table of a group stores it (base64 of C x C int16)."""
    colour = colours(key.sh_dc, key.sh_rest).astype(np.float64)
    return pack_matrix(fit_colour_transform(colour / colour_steps(steps.sh_dc, steps.sh_rest, colour.shape[1])))

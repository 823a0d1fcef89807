"""Attributes <-> channels. N rows, T frames, C colour channels; every function has its inverse beside it.

Encoder side in float64; decoder side in float32 but for canonical means. Channel order of an atlas:
key: log-scales xyz, rotation vector xyz, opacity, colour 0..C-1; state: means xyz before those.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airgs_codec.gaussians import sigmoid

Floats = NDArray[np.floating]

# Decoded opacities stay inside [2^-20, 1 - 2^-20]: outside, the logit of a stored .ply is infinite.
OPACITY_MARGIN = np.float32(2.0**-20)
# Below this angle (radians) sin(a/2)/a is 1/2 to float64 precision; above it the division is safe.
SMALL_ANGLE = 1e-8


def to_rotation_vector(quaternions: Floats) -> Floats:
    """(..., 4) unit w, x, y, z -> (..., 3) axis * angle in radians, angle in [0, pi] (q and -q agree)."""
    q = np.where(quaternions[..., :1] < 0, -quaternions, quaternions)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, q[..., :1])
    return q[..., 1:] * np.where(sine > SMALL_ANGLE, angle / np.maximum(sine, SMALL_ANGLE), 2)


def from_rotation_vector(vectors: Floats) -> Floats:
    """(..., 3) -> (..., 4) unit quaternions; any angle."""
    angle = np.sqrt(np.einsum("...i,...i", vectors, vectors))[..., None]
    factor = np.where(angle > SMALL_ANGLE, np.sin(angle / 2) / np.maximum(angle, SMALL_ANGLE), 0.5)
    return np.concatenate([np.cos(angle / 2), factor * vectors], axis=-1).astype(vectors.dtype)


def multiply(a: Floats, b: Floats) -> Floats:
    """Hamilton product a b of (..., 4) quaternions: rotate by b, then by a."""
    aw, ax, ay, az = (a[..., i] for i in range(4))
    bw, bx, by, bz = (b[..., i] for i in range(4))
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def conjugate(q: Floats) -> Floats:
    """Inverse of unit quaternions."""
    return q * np.array([1, -1, -1, -1], q.dtype)


def to_opacity(logits: Floats) -> Floats:
    """Logit -> alpha in [0, 1]."""
    return sigmoid(logits)


def from_opacity(opacity: NDArray[np.float32]) -> NDArray[np.float32]:
    """Decoded alpha, which coding error may carry out of [0, 1], -> finite logit."""
    a = np.clip(opacity, OPACITY_MARGIN, 1 - OPACITY_MARGIN)
    return np.log(a / (1 - a))


def motion_classes(sensitivity: NDArray[np.float64], floor: float) -> NDArray[np.int16]:
    """(N,) squared derivative of the picture by a row's mean, 1 / world unit^2 -> class c, its motion unit 2^c.

    The unit is the nearest power of two to 1 / sqrt(derivative): a row that the picture depends on more is sent finer.
    `floor` (> 0) is the least sensitivity that counts.
    """
    return np.clip(np.rint(-0.25 * np.log2(np.maximum(sensitivity, floor))), -128, 127).astype(np.int16)


def motion_units(classes: NDArray[np.int16]) -> NDArray[np.float32]:
    """(N,) class -> 2^c, what a row's displacement is counted in (world units)."""
    return np.exp2(classes.astype(np.float32))


def colours(sh_dc: Floats, sh_rest: Floats) -> Floats:
    """(..., N, 3) and (..., N, K, 3) -> (..., N, C): DC r g b, then each SH rest coefficient r g b."""
    return np.concatenate([sh_dc, sh_rest.reshape(*sh_rest.shape[:-2], -1)], axis=-1)


def split_colours(channels: Floats) -> tuple[Floats, Floats]:
    """Inverse of `colours`."""
    rest = channels[..., 3:]
    return channels[..., :3], rest.reshape(*rest.shape[:-1], -1, 3)


def colour_steps(sh_dc: float, sh_rest: float, channels: int) -> NDArray[np.float64]:
    """(C,) step of each colour channel before the KLT; after it every step is 1."""
    return np.where(np.arange(channels) < 3, sh_dc, sh_rest)


def fit_colour_transform(scaled: NDArray[np.float64]) -> NDArray[np.float64]:
    """Orthonormal KLT of (N, C) colours in units of their steps: (C, C), row k the k-th strongest direction.

    Row signs are fixed (largest entry positive), so that equal scenes give equal packages.
    """
    centred = scaled - scaled.mean(axis=0)
    _, vectors = np.linalg.eigh(centred.T @ centred)
    rows = vectors.T[::-1]
    strongest = np.take_along_axis(rows, np.abs(rows).argmax(axis=1)[:, None], axis=1)
    return rows * np.where(strongest < 0, -1.0, 1.0)


def to_klt(scaled: NDArray[np.float64], transform: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., C) colours in steps -> KLT channels, exact inverse of `from_klt` for the stored (rounded) transform."""
    return scaled @ np.linalg.inv(transform)


def from_klt(channels: Floats, transform: Floats) -> Floats:
    """(..., C) KLT channels -> colours in units of their steps."""
    return channels @ transform

"""Unit quaternions w, x, y, z and rotation vectors: axis * angle, in radians. Arrays (..., 4), (..., 3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating]

# Below this angle (radians) sin(a/2)/a is 1/2 to float64 precision; above it the division is safe.
SMALL_ANGLE = 1e-8


def to_rotation_vector(quaternions: Floats) -> Floats:
    """(..., 4) unit quaternions -> (..., 3) rotation vectors with an angle in [0, pi]; q and -q give the same."""
    q = np.where(quaternions[..., :1] < 0, -quaternions, quaternions)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, q[..., :1])
    return q[..., 1:] * np.where(sine > SMALL_ANGLE, angle / np.maximum(sine, SMALL_ANGLE), 2)


def from_rotation_vector(vectors: Floats) -> Floats:
    """(..., 3) rotation vectors of any angle -> (..., 4) unit quaternions."""
    angle = np.sqrt(np.einsum("...i,...i", vectors, vectors))[..., None]
    factor = np.where(angle > SMALL_ANGLE, np.sin(angle / 2) / np.maximum(angle, SMALL_ANGLE), 0.5)
    return np.concatenate([np.cos(angle / 2), factor * vectors], axis=-1).astype(vectors.dtype)


def multiply(a: Floats, b: Floats) -> Floats:
    """The Hamilton product a b of (..., 4) quaternions: the rotation by b, then by a."""
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
    """(..., 4) unit quaternions -> their inverses."""
    return q * np.array([1, -1, -1, -1], q.dtype)


def to_matrices(quaternions: Floats) -> NDArray[np.float64]:
    """(..., 4) quaternions of any length but 0 -> (..., 3, 3) rotations: column c is what axis c becomes."""
    q = np.asarray(quaternions, np.float64)
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    w, x, y, z = (q[..., i] for i in range(4))
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

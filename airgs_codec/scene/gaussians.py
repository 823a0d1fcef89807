"""One frame of 3D Gaussians, as .ply files store it, and what is calculated with its columns.

Scales are stored as logarithms, opacities as logits, rotations as quaternions w, x, y, z. Rotation vectors are axis *
angle, in radians. N Gaussians, K = (degree + 1)^2 - 1 SH coefficients past DC.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.scene.columns import Columns

SH_C0 = 0.28209479177387814  # 1 / (2 sqrt(pi)), real SH band 0
LEAST_SHARE = 1e-9
FAR = 100.0  # times the median distance from the middle of a scene: what is further away decides less
ALPHA_LIMIT = 2.0**-20  # of a mean alpha, whose logit would be infinite at 0 and 1
SH_REST = (0, 3, 8, 15)  # SH coefficients past DC for degree 0..3
SATURATED_LOGIT = np.float32(math.log(1019))  # a quarter of a step of 1/255 off 0 and 1, whose logits are infinite
LARGEST = 30.0  # ln(world units) of a scale that counts: the squares of larger ones leave float32
SMALL_ANGLE = 1e-8  # radians, below which sin(a/2)/a is 1/2 to float64 precision; above it the division is safe
Floats = NDArray[np.floating]
Doubles = NDArray[np.float64]
_SHAPES = {"means": (3,), "quaternions": (4,), "log_scales": (3,), "opacity_logits": (), "sh_dc": (3,)}  # past N
# Each step moves the bits of a 21-bit number away from each other: shift, then mask.
_MASKS = [0x1FFFFF, 0x1F00000000FFFF, 0x1F0000FF0000FF, 0x100F00F00F00F00F, 0x10C30C30C30C30C3, 0x1249249249249249]
_SPREAD = [(np.uint64(32 >> step), np.uint64(mask)) for step, mask in enumerate(_MASKS[1:])]
# (24, 4) unit quaternions of the rotations that bring a cube to itself, one of q and -q.
_WHOLE = [q for q in itertools.product((0.0, 1.0, -1.0), repeat=4) if np.count_nonzero(q) in (1, 2, 4)]
CUBE = np.array([np.divide(q, np.linalg.norm(q)) for q in _WHOLE if next(filter(None, q)) > 0])


@dataclass(frozen=True, slots=True, eq=False)
class Gaussians(Columns):
    """One frame of N Gaussians in stored domain, float32. Row n is the same Gaussian in every frame of a group.

    means           (N, 3)     world units
    quaternions     (N, 4)     w, x, y, z; any length but 0
    log_scales      (N, 3)     ln(world units)
    opacity_logits  (N,)       logit of alpha in [0, 1]
    sh_dc           (N, 3)     r, g, b
    sh_rest         (N, K, 3)  K = 0, 3, 8 or 15 coefficients for SH degree 0 to 3, band by band, order -l to l; r, g, b

    The covariance of a Gaussian is R S S^T R^T, with R its rotation and S the diagonal of its scales; its colour seen
    along direction d is max(0, 0.5 + SH(d)) (3D Gaussian Splatting, Kerbl et al. 2023).

    Tensors of torch become arrays. Raises SceneError for an array of another shape. Numbers that are not finite
    are repaired later.
    """

    means: NDArray[np.float32]
    quaternions: NDArray[np.float32]
    log_scales: NDArray[np.float32]
    opacity_logits: NDArray[np.float32]
    sh_dc: NDArray[np.float32]
    sh_rest: NDArray[np.float32]

    def __post_init__(self) -> None:
        rows = next(iter(getattr(self.means, "shape", ())), 0)
        for name, value in self.columns().items():
            shape = getattr(value, "shape", None)
            if shape is not None and not (isinstance(value, np.ndarray) and value.dtype.kind == "f"):
                object.__setattr__(self, name, as_floats(name, value))
            rest = [(k, 3) for k in SH_REST] if name == "sh_rest" else [_SHAPES[name]]
            if shape not in [(rows, *one) for one in rest]:
                expected = f"({rows}, K, 3) with K of 0, 3, 8 or 15" if name == "sh_rest" else (rows, *rest[0])
                expected = "(N, 3)" if name == "means" else expected
                got = type(value).__name__ if shape is None else tuple(shape)
                raise SceneError(f"{name}: expected an array of shape {expected}, got {got}")

    def __repr__(self) -> str:
        ends = [f"({', '.join(f'{x:.4g}' for x in end(self.means, axis=0))})" for end in (np.min, np.max) if len(self)]
        return f"Gaussians({len(self)} rows of SH degree {self.sh_degree}{' from ' * bool(ends)}{' to '.join(ends)})"

    @property
    def sh_degree(self) -> int:
        return SH_REST.index(self.sh_rest.shape[1])

    def with_degree(self, degree: int) -> Gaussians:
        """Return the same Gaussians without the SH bands above `degree`, which is at most theirs."""
        return replace(self, sh_rest=self.sh_rest[:, : SH_REST[degree]])

    def placed(self, shift: NDArray[np.float64], scale: float) -> Gaussians:
        """Return the same shifted by (3,), and then scaled by a factor above 0."""
        means = (self.means + shift) * scale
        sizes = self.log_scales + np.float32(math.log(scale))
        return replace(self, means=means.astype(np.float32), log_scales=sizes.astype(np.float32))

    def opacities(self) -> NDArray[np.float32]:
        """Return opacity alpha in [0, 1], (N,), the sigmoid of the logits."""
        return sigmoid(self.opacity_logits)

    def areas(self) -> NDArray[np.float64]:
        """Return the product (N,) of the two larger scales and opacity, in square world units: what rows can cover."""
        scales = np.sort(self.log_scales.astype(np.float64), axis=1)
        return np.exp(np.minimum(scales[:, 1] + scales[:, 2], 2 * LARGEST)) * self.opacities()


def as_floats(where: str, value: Any, wide: bool = False) -> NDArray[Any]:
    """Return an array or a torch tensor as float32, without a copy where it is that; doubles stay where `wide`.

    Raises SceneError, which begins with `where`, for what is no array of real numbers.
    """
    try:
        if hasattr(value, "detach"):
            value = value.detach().cpu()
            value = (value if value.dtype.itemsize > 4 else value.float()).numpy()
        value = np.asarray(value)
        kind = np.float64 if wide and value.dtype.itemsize > 4 else np.float32
        with np.errstate(over="ignore"):  # what becomes infinite is refused
            return value.astype(kind, casting="same_kind", copy=False)
    except (TypeError, ValueError) as error:
        raise SceneError(f"{where}: expected an array of numbers: {' '.join(str(error).split())[:120]}") from error


def mean_frame(frames: Sequence[Gaussians]) -> Gaussians:
    """Return the mean of frames of the same rows, each row weighed by its alpha.

    Frames in which a row is far from the scene count less, by the area that it takes in pictures. Alpha itself is
    averaged plainly; of q and -q that is taken which is nearer to the middle frame's. Frames are read one by one.
    """
    middle = frames[len(frames) // 2]
    remoteness = remoteness_in(middle)
    sums = {name: np.zeros(column.shape) for name, column in middle.columns().items()}
    weight = np.zeros(len(middle))

    def weights(g: Gaussians) -> Floats:
        """Return weights above 0, so that frames of rows that are never seen count equally."""
        return (g.opacities().astype(np.float64) + LEAST_SHARE) / np.maximum(remoteness(g), 1) ** 2

    for g in frames:
        weight += weights(g)
    for g in frames:
        share = weights(g) / weight
        turn = np.where(np.einsum("ni,ni->n", g.quaternions, middle.quaternions) < 0, -1.0, 1.0)
        for name, column in g.columns().items():
            values = column * turn[:, None] if name == "quaternions" else column
            values = values * share.reshape(-1, *[1] * (column.ndim - 1))
            sums[name] += g.opacities() if name == "opacity_logits" else values
    alpha = np.clip(sums["opacity_logits"] / len(frames), ALPHA_LIMIT, 1 - ALPHA_LIMIT)
    sums["opacity_logits"] = np.log(alpha / (1 - alpha))
    means = {name: total.astype(np.float32) for name, total in sums.items()}
    means["quaternions"] /= np.linalg.norm(means["quaternions"], axis=1, keepdims=True)
    return Gaussians(**means)


def remoteness_in(scene: Gaussians) -> Callable[[Gaussians], NDArray[np.float64]]:
    """Return a measure (N,) of how far rows are from the middle of a scene, 1 at FAR times the median distance."""
    middle = np.median(scene.means, axis=0).astype(np.float64)

    def away(g: Gaussians) -> NDArray[np.float64]:
        x, y, z = np.abs(g.means - middle).T
        return np.maximum(np.maximum(x, y), z)

    far = FAR * float(np.median(away(scene))) or np.inf
    return lambda g: away(g) / far


def mix_rows(a: Gaussians, b: Gaussians, choose: NDArray[np.bool_]) -> Gaussians:
    """Return rows of `a` where `choose` (N,) says so, else those of `b`."""
    return Gaussians.combined([a, b], lambda ab: np.where(choose.reshape(-1, *[1] * (ab[0].ndim - 1)), *ab))


def sigmoid(x: NDArray[np.floating]) -> NDArray:
    """Return 1 / (1 + e^-x) without overflow; -inf gives 0 and inf gives 1."""
    z = np.exp(-np.abs(x))
    return np.where(x >= 0, 1 / (1 + z), z / (1 + z)).astype(np.asarray(x).dtype)


def logits_of(alpha: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return logits of opacities in [0, 1], those nearer to 0 or 1 than 1/1020 as that, so that none is infinite."""
    alpha = alpha.astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        logits = np.log(alpha / (1 - alpha))
    return np.clip(logits, -SATURATED_LOGIT, SATURATED_LOGIT).astype(np.float32)


def logs_of(sizes: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return logarithms of sizes; -inf of 0, NaN of NaN and of negative ones."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.log(sizes).astype(np.float32)


def to_rotation_vector(quaternions: Floats) -> Floats:
    """Return rotation vectors (..., 3), angles in [0, pi], of unit quaternions (..., 4); q and -q give the same."""
    q = np.where(quaternions[..., :1] < 0, -quaternions, quaternions)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, q[..., :1])
    return q[..., 1:] * np.where(sine > SMALL_ANGLE, angle / np.maximum(sine, SMALL_ANGLE), 2)


def from_rotation_vector(vectors: Floats) -> Floats:
    """Return unit quaternions (..., 4) of rotation vectors (..., 3) of any angle."""
    angle = np.sqrt(np.einsum("...i,...i", vectors, vectors))[..., None]
    factor = np.where(angle > SMALL_ANGLE, np.sin(angle / 2) / np.maximum(angle, SMALL_ANGLE), 0.5)
    return np.concatenate([np.cos(angle / 2), factor * vectors], axis=-1).astype(vectors.dtype)


def multiply(a: Floats, b: Floats) -> Floats:
    """Return the Hamilton product a b of (..., 4) quaternions: the rotation by b, then by a."""
    aw, ax, ay, az = (a[..., i] for i in range(4))
    bw, bx, by, bz = (b[..., i] for i in range(4))
    w = aw * bw - ax * bx - ay * by - az * bz
    x = aw * bx + ax * bw + ay * bz - az * by
    y = aw * by - ax * bz + ay * bw + az * bx
    z = aw * bz + ax * by - ay * bx + az * bw
    return np.stack([w, x, y, z], axis=-1)


def conjugate(q: Floats) -> Floats:
    return q * np.array([1, -1, -1, -1], q.dtype)


def least_turned(g: Gaussians) -> NDArray[np.intp]:
    """Return (N,) which of CUBE must follow each of N unit quaternions for the smallest rotation."""
    return np.asarray(np.abs(g.quaternions @ (CUBE * [1, -1, -1, -1]).T).argmax(axis=1))


def rename_axes(g: Gaussians, cube: NDArray[np.intp]) -> Gaussians:
    """Turn each row by a rotation (N,) of CUBE first and reorder its log-scales, so that it shows the same."""
    axes = np.abs(to_matrices(CUBE)).argmax(axis=1)[cube]
    turned = multiply(g.quaternions.astype(np.float64), CUBE[cube]).astype(np.float32)
    return replace(g, quaternions=turned, log_scales=np.take_along_axis(g.log_scales, axes, axis=1))


def to_matrices(quaternions: Floats) -> NDArray[np.float64]:
    """Return rotations (..., 3, 3) of quaternions (..., 4) of any length but 0: column c is what axis c becomes."""
    q = np.asarray(quaternions, np.float64)
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    w, x, y, z = (q[..., i] for i in range(4))
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def morton_encode(index: NDArray[np.integer]) -> NDArray[np.uint64]:
    """Return codes (M,) of (M, 3) grid indices of at most 21 bits: bit 3b + axis is bit b of that axis."""
    code = np.zeros(len(index), np.uint64)
    for axis in range(3):
        v = index[:, axis].astype(np.uint64)
        for shift, mask in _SPREAD:
            v = (v | (v << shift)) & mask
        code |= v << np.uint64(axis)
    return code


def morton_order(means: NDArray[np.floating], bits: int = 16) -> NDArray[np.intp]:
    """Return rows (N,) along a Z-order curve through the box of `means` (N, 3), N > 0, in cells of 2^bits an axis."""
    low = means.min(axis=0).astype(np.float64)
    span = float((means.max(axis=0) - low).max()) or 1.0  # all in one place: 0 / 0
    return np.argsort(morton_encode(((means - low) / span * (2**bits - 1)).astype(np.int64)), kind="stable")


def morton_decode(code: NDArray[np.uint64]) -> NDArray[np.uint32]:
    """Return the (M, 3) grid indices of codes (M,), the inverse of `morton_encode`."""
    index = np.empty((len(code), 3), np.uint32)
    for axis in range(3):
        v = (code >> np.uint64(axis)) & _SPREAD[-1][1]
        for (shift, _), mask in zip(_SPREAD[::-1], _MASKS[-2::-1], strict=True):
            v = (v | (v >> shift)) & np.uint64(mask)
        index[:, axis] = v
    return index

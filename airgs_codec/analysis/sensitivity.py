"""How much single Gaussians contribute to pictures, and how much a picture changes when an attribute of one does.

Both come from one pass over the pictures. N Gaussians.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from airgs_codec._sampling import evenly_spaced
from airgs_codec.package.tables import DELTA_ATTRIBUTES
from airgs_codec.render import Camera, Contribution
from airgs_codec.render.backend import CPU, Renderer
from airgs_codec.render.cpu import RasterInputs
from airgs_codec.scene.beside import Usage
from airgs_codec.scene.columns import Columns
from airgs_codec.scene.gaussians import Gaussians

Floats = NDArray[np.float32]
MAX_VIEWS = 8  # rendered for each frame; more views change the estimate little
CODING_VARIANCE = 0.1  # steps^2: 1/12 of the quantiser and some of H.264


class UsageSums:
    """Adds up what single pictures say about N rows."""

    def __init__(self, rows: int) -> None:
        self._total, self._peak, self._hits = np.zeros(rows), np.zeros(rows), np.zeros(rows, np.int64)

    def add(self, seen: Contribution) -> None:
        self._total += seen.total
        self._peak = np.maximum(self._peak, seen.peak)
        self._hits += seen.hits

    def usage(self) -> Usage:
        return Usage(self._total, self._peak, self._hits)


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivity(Columns):
    """Mean over picture samples of the squared derivative by each channel of an attribute, summed over its channels.

    To first order, independent errors of variance v in every channel of an attribute raise the mean squared error of
    the pictures by v times the sum over the rows. Units: picture value^2 / attribute unit^2.
    """

    means: NDArray[np.float64]  # (N,) per world unit
    quaternions: NDArray[np.float64]  # (N,) per radian, of a rotation applied after the row's own
    log_scales: NDArray[np.float64]  # (N,)
    opacity: NDArray[np.float64]  # (N,) per alpha
    sh_dc: NDArray[np.float64]  # (N,)
    sh_rest: NDArray[np.float64]  # (N,)

    def by_attribute(self) -> NDArray[np.float64]:
        """Return (6, N) the same as one array, in the order of `package.tables.DELTA_ATTRIBUTES`."""
        return np.stack([getattr(self, name) for name in DELTA_ATTRIBUTES])


def measure_sensitivity(
    frames: Sequence[Gaussians], cameras: Sequence[Camera], renderer: Renderer = CPU
) -> Sensitivity:
    """Return the mean over `frames` (of one group) and at most MAX_VIEWS cameras spread evenly."""
    chosen = [cameras[i] for i in evenly_spaced(len(cameras), MAX_VIEWS)]
    return measure_views([(frame, camera) for frame in frames for camera in chosen], renderer)[1]


def measure_views(pictures: Iterable[tuple[Gaussians, Camera]], renderer: Renderer = CPU) -> tuple[Usage, Sensitivity]:
    """Measure usage and sensitivity of the rows of a group in some pictures, each drawn once for both.

    A picture is a frame of the group and a camera; pictures of one frame that follow each other share work. One random
    sign a picture sample: the squared derivative of a signed sum is, on average over signs, the sum of squared
    derivatives (Hutchinson 1990). The signs are the same in every run. At least one picture; iterated over twice.
    """
    rng, rows = np.random.default_rng(0), len(next(iter(pictures))[0])
    usage, squares = UsageSums(rows), np.zeros((len(fields(Sensitivity)), rows))
    samples, shown = 0, None
    for frame, camera in pictures:
        if frame is not shown:
            shown, loaded = frame, renderer.load(frame)
        signs = rng.integers(0, 2, (camera.height, camera.width, 3)).astype(np.float32) * 2 - 1
        contribution, derivatives = loaded.contribution_and_gradients(camera, signs)
        usage.add(contribution)
        squares += _squares(loaded.inputs, derivatives)
        samples += signs.size
    return usage.usage(), Sensitivity(*(squares / samples))


def _squares(active: RasterInputs[Floats], derivatives: RasterInputs[Floats]) -> NDArray[np.float64]:
    """Return (6, N) squared derivatives by what is coded, summed over channels, from those by activated attributes."""
    means, quaternions, scales, opacity, sh = derivatives
    # A rotation by a small w after q adds (0, w) q / 2. These three directions and q are orthogonal, each with length
    # |q| / 2 for a unit w; the derivative has no part along q.
    turns = quaternions * (np.linalg.norm(active.quaternions.astype(np.float64), axis=1, keepdims=True) / 2)
    # An infinite scale is not drawn and pulls at nothing: 0, where 0 * inf would be no number.
    sizes = np.multiply(scales, active.scales, out=np.zeros_like(scales), where=scales != 0)
    columns = (means, turns, sizes, opacity[:, None], sh[:, 0], sh[:, 1:].reshape(len(sh), -1))
    return np.stack([np.einsum("ni,ni->n", c, c, dtype=np.float64) for c in columns])

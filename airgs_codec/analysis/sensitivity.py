"""How much a picture changes when an attribute of one Gaussian does. N Gaussians."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from airgs_codec._sampling import evenly_spaced
from airgs_codec.render import Camera, cpu
from airgs_codec.render.inputs import BLACK
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.rotations import multiply

MAX_VIEWS = 8  # rendered for each frame; more views change the estimate little
CODING_VARIANCE = 0.1  # steps^2: 1/12 of the quantiser and some of H.264
LEAK = 0.3  # share of CODING_VARIANCE that a channel gets from its neighbours when nothing in it is worth coding
FLOOR = 0.01  # of the median: rows that the given views hardly see may be seen from others


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivity:
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

    def take(self, rows: NDArray[np.intp]) -> Sensitivity:
        """The sensitivity of some rows, in the order of `rows`."""
        return Sensitivity(*(getattr(self, f.name)[rows] for f in fields(self)))


def measure_sensitivity(frames: Sequence[Gaussians], cameras: Sequence[Camera]) -> Sensitivity:
    """Mean over `frames` (of one group) and at most MAX_VIEWS cameras spread evenly.

    One random sign a picture sample: the squared derivative of a signed sum is, on average over signs, the sum of
    squared derivatives (Hutchinson 1990). The signs are the same in every run.
    """
    rng = np.random.default_rng(0)
    sums = np.zeros((len(fields(Sensitivity)), len(frames[0])))
    samples = 0
    for frame in frames:
        for camera in (cameras[i] for i in evenly_spaced(len(cameras), MAX_VIEWS)):
            signs = rng.integers(0, 2, (camera.height, camera.width, 3)).astype(np.float32) * 2 - 1
            sums += _squares(frame, camera, signs)
            samples += signs.size
    return Sensitivity(*(sums / samples))


def _squares(g: Gaussians, camera: Camera, signs: NDArray[np.float32]) -> NDArray[np.float64]:
    """(6, N) squared derivatives of the signed sum of picture samples, summed over channels."""
    active = cpu.activate(g)
    opaque = np.zeros(signs.shape[:2], np.float32)
    blended = cpu.blend(active, camera, BLACK)
    means, quaternions, scales, opacity, sh = cpu.gradients(active, camera, blended, signs, opaque).inputs
    # A rotation by a small w after q adds (0, w) q / 2: the derivative by w is the inner product with that.
    turns = [multiply(np.eye(4)[axis] / 2, active.quaternions.astype(np.float64)) for axis in (1, 2, 3)]
    rotation = np.stack([np.einsum("ni,ni->n", turn, quaternions) for turn in turns], axis=1)
    # An infinite scale is not drawn and pulls at nothing: 0, where 0 * inf would be no number.
    sizes = np.multiply(scales, active.scales, out=np.zeros_like(scales), where=scales != 0)
    columns = (means, rotation, sizes, opacity[:, None], sh[:, 0], sh[:, 1:].reshape(len(g), -1))
    return np.stack([np.einsum("ni,ni->n", c, c) for c in (c.astype(np.float64) for c in columns)])

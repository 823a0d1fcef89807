"""Quantiser steps, and what follows from how much pictures depend on rows: motion classes, and what errors cost.

The displacement of a row is sent the finer, the more pictures depend on it: a row of class c has the motion unit 2^c
world units, times the scale of the scene, which steps of lengths contain. Rows that move together have one class:
neighbours then have similar samples, which video codecs code well.
N rows, T frames, C colour channels.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, astuple, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.package.layout import COLOUR, DELTA
from airgs_codec.package.tables import BLOCK, DELTA_ATTRIBUTES, LEAST_CLASS, MOST_CLASS, DeltaSteps, KeyframeSteps
from airgs_codec.scene.gaussians import Doubles, Floats, Gaussians

Classes = NDArray[np.int16]
LEAVES = 1e4  # steps
FLOOR = 0.01  # of the median: rows that the given views hardly see may be seen from others
_KEYFRAME = KeyframeSteps(quaternions=0.025, log_scales=0.08, opacity=0.014, sh_dc=0.036, sh_rest=0.04)
_DELTA = DeltaSteps(0.0007, quaternions=0.03, log_scales=0.12, opacity=0.058, sh_dc=0.063, sh_rest=0.08)


@dataclass(frozen=True, slots=True)
class StepSettings:
    """Quantiser steps at quality factor 1; lengths are in motion units (see `motion`) times the scale of the scene.

    Calibration starts from the defaults, which lie between what the walking fox and the N3DV spinach scene ask for.
    """

    keyframe: KeyframeSteps = _KEYFRAME
    delta: DeltaSteps = _DELTA
    grid: float = 0.0007  # side of the cells of canonical means, in motion units
    colours: tuple[float, ...] = ()  # (3, 3), row by row, of `fit_colour_transform`; empty: r, g, b matter equally
    rows: float = 0.0027  # error of pictures (RMS, of [0, 1]) that leaving out Gaussians may make

    def at_scale(self, scale: float) -> StepSettings:
        """Return these steps of a scene of scale 1 for one of another scale."""
        return replace(self, delta=replace(self.delta, means=self.delta.means * scale), grid=self.grid * scale)

    def scaled(self, quality: float) -> StepSettings:
        """Return these steps times a quality factor; `rows`, an error of pictures, stays."""
        keyframe = KeyframeSteps(*(step * quality for step in astuple(self.keyframe)))
        delta = DeltaSteps(*(step * quality for step in astuple(self.delta)))
        return replace(self, keyframe=keyframe, delta=delta, grid=self.grid * quality)


def get_step(steps: StepSettings, name: str) -> float:
    """Return a step by its name: such as delta.means, grid or rows."""
    side, _, attribute = name.partition(".")
    return float(getattr(getattr(steps, side), attribute) if attribute else getattr(steps, side))


def with_step(steps: StepSettings, name: str, value: float) -> StepSettings:
    side, _, attribute = name.partition(".")
    changed: Any = replace(getattr(steps, side), **{attribute: value}) if attribute else value
    return replace(steps, **{side: changed})


def scale_steps(steps: StepSettings, factors: Mapping[str, float]) -> StepSettings:
    """Return these steps times factors on some, rounded to powers of 2^(1/8): what is measured is no better.

    So scenes that differ by little, or by their unit, mostly have equal steps.
    """
    for name, factor in factors.items():
        wanted = get_step(steps, name) * 2.0 ** (round(8 * math.log2(factor)) / 8)
        steps = with_step(steps, name, float(f"{wanted:.9g}"))
    return steps


def motion_classes(sensitivity: Doubles, floor: float, scale: float = 1.0) -> Classes:
    """Return (N,) motion classes of (N,) mean squared derivatives of pictures by the rows' means, 1 / world unit^2.

    The motion unit is the power of two nearest to the fourth root of 1 / `sensitivity`, with lengths in units of
    `scale`. `floor` (> 0) is the least sensitivity that counts: of a row that no picture shows the logarithm is
    infinite.
    """
    wanted = -0.25 * np.log2(np.maximum(sensitivity, floor)) - 0.5 * math.log2(scale)
    return np.clip(np.rint(wanted), LEAST_CLASS, MOST_CLASS).astype(np.int16)


def motion_units(classes: Classes) -> NDArray[np.float32]:
    return np.exp2(classes.astype(np.float32))


def classify_motion(sensitivity: Doubles, g: Gaussians, scale: float) -> Classes:
    """Return (N,) motion classes by (N,) `sensitivity`, or by the median size where no row is seen."""
    if len(seen := sensitivity[sensitivity > 0]):
        return motion_classes(sensitivity, FLOOR * float(np.median(seen)), scale)
    size = float(np.exp(np.clip(np.median(g.log_scales.astype(np.float64)), -30, 30)))
    return np.full(len(g), round(math.log2(size / scale)), np.int16)


def share_class(classes: Classes, sensitivity: Floats, displacements: Iterable[Floats], step: float) -> Classes:
    """Return (N,) motion classes, or one for all rows where their displacements take fewer bits with it.

    `classes` and `sensitivity` (N,) are those of rows in file order, `displacements` (3, N) of some frames, in world
    units, `step` that of means. With one class equal steps err about as much in pictures. Rows that move further than
    LEAVES steps are left out.
    """
    if not (total := float(sensitivity.sum())):
        return classes
    units = motion_units(classes).astype(np.float64)
    shared = math.sqrt(float(sensitivity @ np.square(units)) / total)
    separate = together = 0.0
    for moved in displacements:
        moved = np.where(np.abs(moved).max(axis=0) > LEAVES * step * shared, 0, moved)
        separate += _transform_bits(moved / (step * units))
        together += _transform_bits(moved / (step * shared))
    return np.full_like(classes, round(math.log2(shared))) if together < separate else classes


def _transform_bits(samples: NDArray[np.floating]) -> float:
    """Return about the bits that samples (c, N), in steps, of rows in file order take in an atlas.

    The Walsh-Hadamard transform of a block of rows is also that of their places in it. A coefficient x takes
    log2(1 + x^2) / 2 bits: the rate of a Gaussian source (Cover and Thomas, Elements of Information Theory, 10.3.2).
    """
    rows = BLOCK * BLOCK
    blocks = np.pad(samples, ((0, 0), (0, -samples.shape[1] % rows))).reshape(-1, rows)
    return float(np.log2(1 + np.square(blocks @ _hadamard(rows))).sum()) / 2


@functools.cache
def _hadamard(order: int) -> Doubles:
    matrix: NDArray[Any] = np.ones((1, 1))
    while len(matrix) < order:
        matrix = np.kron([[1, 1], [1, -1]], matrix) / math.sqrt(2)
    return matrix


def channel_weights(classes: Classes, sensitivity: Doubles, steps: DeltaSteps, transform: Doubles) -> Doubles:
    """Return (10 + C, N) what an error of one step in a delta channel adds to the mean squared error of pictures.

    `sensitivity` (6, N): mean squared derivatives of pictures by each of DELTA_ATTRIBUTES, summed over its channels.
    Derivatives by the channels of one attribute are taken to be equal, and errors of different channels independent.
    Colour channel k changes SH DC and SH rest by the entries of row k of the KLT `transform` (C, C).
    """
    colours = len(transform)
    dc, rest = (np.square(part).sum(axis=1) for part in np.hsplit(transform, [3]))
    by = dict(zip(DELTA_ATTRIBUTES, sensitivity, strict=True))
    units = asdict(steps) | {"means": motion_units(classes).astype(np.float64) * steps.means}
    weights = np.empty((DELTA.width(colours), len(classes)))
    for name, channels in DELTA.runs:
        weights[DELTA.slice(name)] = by[name] * units[name] ** 2 / channels
    weights[DELTA.slice(COLOUR)] = np.outer(dc, by["sh_dc"] * steps.sh_dc**2 / 3)
    if colours > 3:
        weights[DELTA.slice(COLOUR)] += np.outer(rest, by["sh_rest"] * steps.sh_rest**2 / (colours - 3))
    return weights


def withheld_error(changes: Doubles, weights: Doubles) -> Doubles:
    """Return (N,) the mean squared error of pictures when changes (T, 10 + C, N), in steps, are not sent."""
    return np.einsum("tcn,tcn,cn->n", changes, changes, weights, optimize=True) / len(changes)

"""Uniform quantisation: values <-> whole codes, `gain` codes a step; steps of scenes. T frames, C channels, N rows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.package.tables import KEY_ATTRIBUTES, STATE_ATTRIBUTES, KeySteps, StateSteps

CODE_LIMIT = 1 << 30  # |code| stays below it, so that sums of a code, a centre and a base fit int32
STEP_LIMITS = (1e-30, 1e30)  # of steps: products of codes and steps are float32


class UncodableError(SceneError):
    """A value that no code holds."""


@dataclass(frozen=True, slots=True)
class StepSettings:
    """Quantiser steps at quality factor 1; lengths are in motion units (see `motion`) times the scale of the scene.

    Calibration starts from the defaults, which lie between what the walking fox and the N3DV spinach scene ask for.
    """

    key: KeySteps = field(
        default_factory=lambda: KeySteps(quaternions=0.025, log_scales=0.08, opacity=0.014, sh_dc=0.036, sh_rest=0.04)
    )
    state: StateSteps = field(
        default_factory=lambda: StateSteps(
            means=0.0007, quaternions=0.03, log_scales=0.12, opacity=0.058, sh_dc=0.063, sh_rest=0.08
        )
    )
    grid: float = 0.0007  # side of the cells of canonical means, in motion units
    colours: tuple[float, ...] = ()  # (3, 3), row by row, of `fit_colour_transform`; empty: r, g, b matter alike
    rows: float = 0.0027  # error of pictures (RMS, of [0, 1]) that leaving out Gaussians may make

    def at_scale(self, scale: float) -> StepSettings:
        """These steps, which are those of a scene of scale 1, for one of another scale."""
        return replace(self, state=replace(self.state, means=self.state.means * scale), grid=self.grid * scale)

    def scaled(self, quality: float) -> StepSettings:
        """These steps times a quality factor; `rows`, an error of pictures, stays."""
        key = KeySteps(*(getattr(self.key, name) * quality for name in KEY_ATTRIBUTES))
        state = StateSteps(*(getattr(self.state, name) * quality for name in STATE_ATTRIBUTES))
        return replace(self, key=key, state=state, grid=self.grid * quality)


def get_step(steps: StepSettings, name: str) -> float:
    """A step by its name: such as state.means, grid or rows."""
    side, _, attribute = name.partition(".")
    return float(getattr(getattr(steps, side), attribute) if attribute else getattr(steps, side))


def with_step(steps: StepSettings, name: str, value: float) -> StepSettings:
    side, _, attribute = name.partition(".")
    changed: Any = replace(getattr(steps, side), **{attribute: value}) if attribute else value
    return replace(steps, **{side: changed})


def scale_steps(steps: StepSettings, factors: Mapping[str, float]) -> StepSettings:
    """These steps times a factor on each of some, to a power of 2^(1/8): what is measured is no better.

    So scenes that differ by little, or by their unit, mostly have equal steps.
    """
    for name, factor in factors.items():
        wanted = get_step(steps, name) * 2.0 ** (round(8 * math.log2(factor)) / 8)
        steps = with_step(steps, name, float(f"{wanted:.9g}"))
    return steps


def to_codes(values: NDArray[np.float64], steps: NDArray[np.float64], gain: float, first: int = 0) -> NDArray[np.int32]:
    """(T, C, N) values, (C,) steps -> (T, C, N) codes; `from_codes` is at most step / (2 gain) off.

    `first` is the number of the first channel, for errors. Raises UncodableError for a value 2^30 codes or more from 0,
    since nothing is clipped, SceneError for a step that is not within STEP_LIMITS.
    """
    low, high = STEP_LIMITS
    if not ((steps >= low) & (steps <= high)).all():
        channel = int(np.argmin((steps >= low) & (steps <= high)))
        raise SceneError(f"channel {first + channel}: expected a step of {low:g} to {high:g}, got {steps[channel]:g}")
    codes = values * (gain / steps)[:, None]
    np.rint(codes, out=codes)
    if codes.size and not max(-codes.min(), codes.max()) < CODE_LIMIT:
        channel = int(np.unravel_index(np.abs(codes).argmax(), codes.shape)[1])
        largest = float(np.abs(values[:, channel]).max())
        got = f"value {largest:g} at step {steps[channel]:g}"
        raise UncodableError(f"channel {first + channel}: expected at most {CODE_LIMIT} codes, got {got}")
    return codes.astype(np.int32)


def from_codes(codes: NDArray[np.int32], steps: NDArray[np.float64], gain: float) -> NDArray[np.float32]:
    """(C, N) codes, (C,) steps -> (C, N) values."""
    return scale_codes(codes, code_units(steps, gain))


def code_units(steps: NDArray[np.float64], gain: float) -> NDArray[np.float32]:
    """(C,) steps -> (C,) values of a code."""
    return (steps / gain).astype(np.float32)


def scale_codes(codes: NDArray[np.int32], units: NDArray[np.float32]) -> NDArray[np.float32]:
    """(C, N) codes, (C,) values of a code -> (C, N) values."""
    values = codes.astype(np.float32)
    values *= units[:, None]
    return values

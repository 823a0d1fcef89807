"""Quantiser steps of one scene, from small encodes of one of its groups.

A step is worth halving while that lowers the error of pictures by more than its bytes would elsewhere: Lagrange's
condition with one multiplier for all choices (Everett 1963), here the price of a byte in squared error.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np

from airgs_codec.coding.steps import StepSettings
from airgs_codec.encoder.calibration.sample import CalibrationSample, Cost
from airgs_codec.encoder.calibration.subject import Subject
from airgs_codec.errors import SceneError

SLOPE = 0.5  # of the bytes: what steps e times as large save, of fox and spinach
TRIAL = 1.5  # factor between the two steps at which bytes and error are measured
PRIOR = 0.02  # share of all bytes and error that every step has at least: a step without effect hardly moves

# The attribute whose planes are coded anew when a step changes.
STEPS = {
    "key.quaternions": "quaternions",
    "key.log_scales": "log_scales",
    "key.opacity": "opacity",
    "key.sh_dc": "colour",
    "key.sh_rest": "colour",
    "grid": "means",
    "state.means": "means",
    "state.quaternions": "quaternions",
    "state.log_scales": "log_scales",
    "state.opacity": "opacity",
    "state.sh_dc": "colour",
    "state.sh_rest": "colour",
}

# m: bytes saved by a step e times as large; b: the error of a step f times as large is b f^2
Slope = tuple[float, float]


def get_step(steps: StepSettings, name: str) -> float:
    """A step by its name in STEPS, or "rows"."""
    side, _, attribute = name.partition(".")
    return float(getattr(getattr(steps, side), attribute) if attribute else getattr(steps, side))


def with_step(steps: StepSettings, name: str, value: float) -> StepSettings:
    """The same steps but one."""
    side, _, attribute = name.partition(".")
    changed: Any = replace(getattr(steps, side), **{attribute: value}) if attribute else value
    return replace(steps, **{side: changed})


def solve_steps(sample: CalibrationSample, subject: Subject) -> tuple[StepSettings, float]:
    """Steps of one price that together make the error that `subject.settings.steps` make, and the price.

    Raises SceneError as `balance`.
    """
    steps = subject.settings.steps
    factors, price = balance(measure_slopes(sample, subject))
    for name, factor in factors.items():
        steps = with_step(steps, name, float(f"{get_step(steps, name) * factor:.4g}"))
    return steps, price


def balance(slopes: Mapping[str, Slope]) -> tuple[dict[str, float], float]:
    """A factor on every step, and the price of a byte; no factors and 0 where no bytes or no error depend on steps.

    Bytes fall with the logarithm of a step, at m; its error is b times its square. With factors f, sum b f^2 stays and
    bytes are least where f^2 = (m / sum m) / (b / sum b); a byte then costs 2 sum b / sum m. PRIOR keeps factors
    within sqrt((1 + PRIOR) / PRIOR), 7.1, of 1. Raises SceneError for slopes that are not finite.
    """
    for name, slope in slopes.items():
        if not np.isfinite(slope).all():
            raise SceneError(f"calibration: expected finite bytes and errors of {name}, got {slope[0]:g}, {slope[1]:g}")
    known = {name: (max(m, 0.0), max(b, 0.0)) for name, (m, b) in slopes.items()}
    rate, error = sum(m for m, _ in known.values()), sum(b for _, b in known.values())
    if rate == 0 or error == 0:
        return {}, 0.0
    shares = {name: (m / rate + PRIOR, b / error + PRIOR) for name, (m, b) in known.items()}
    return {name: (m / b) ** 0.5 for name, (m, b) in shares.items()}, 2 * error / rate


def guess_price(sample: CalibrationSample, subject: Subject) -> float:
    """The price of a byte at the steps of `subject.settings`, from one trial encode.

    Error grows with the square of the steps, bytes fall with their logarithm at about SLOPE of what they are.
    """
    cost = sample.cost(subject.settings.steps)
    return 2 * (cost.key_error + cost.state_error + subject.layout.removal_error) / (SLOPE * cost.bytes)


def measure_slopes(sample: CalibrationSample, subject: Subject) -> dict[str, Slope]:
    """Slopes of every step, from trial encodes a factor TRIAL finer and coarser."""
    steps = subject.settings.steps
    names = [n for n in STEPS if subject.frames[0].sh_rest.shape[1] or not n.endswith("sh_rest")]

    def trial(name: str, factor: float) -> Cost:
        return sample.cost(with_step(steps, name, get_step(steps, name) * factor), (STEPS[name],))

    with ThreadPoolExecutor(subject.settings.threads) as pool:
        finer = list(pool.map(trial, names, itertools.repeat(1 / TRIAL)))
        coarser = list(pool.map(trial, names, itertools.repeat(TRIAL)))
    slopes: dict[str, Slope] = {}
    for name, was, now in zip(names, finer, coarser, strict=True):
        grows = now.state_error - was.state_error + now.key_error - was.key_error
        slopes[name] = (was.bytes - now.bytes) / np.log(TRIAL**2), grows / (TRIAL**2 - TRIAL**-2)
    if subject.layout.removal_error > 0:
        slopes["rows"] = _row_slope(sample, subject)
    return slopes


def _row_slope(sample: CalibrationSample, subject: Subject) -> Slope:
    """The same for the error that leaving out rows may make: what TRIAL times as much would save."""
    steps = subject.settings.steps
    kept = subject.pruning.within(steps.rows * TRIAL)
    fewer = sample.take(np.isin(subject.layout.rows[sample.index], kept.rows)).cost(steps)
    saved = sample.cost(steps).bytes - fewer.bytes
    return saved / np.log(TRIAL), (kept.error - subject.layout.removal_error) / (TRIAL**2 - 1)

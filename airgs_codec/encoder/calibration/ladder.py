"""Levels, key tiers and key qualities of one scene, from small encodes of one of its groups. N rows of the group."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.importance import PICTURES, pair_with_cameras
from airgs_codec.coding.channels import key_channels, state_channels
from airgs_codec.coding.steps import StepSettings
from airgs_codec.encoder.calibration.sample import CalibrationSample
from airgs_codec.encoder.calibration.subject import Subject
from airgs_codec.encoder.levels import assign_depths
from airgs_codec.encoder.rank import rank_updates
from airgs_codec.media.metrics import mse
from airgs_codec.package.layout import STATE
from airgs_codec.render import render
from airgs_codec.scene.gaussians import Gaussians

LEVEL_PRICES = (1.0, 2.5, 6.0, 12.0)  # price of a byte at each level / price at the top level
KEY_PRICE = 7.0  # price of a byte at the second key quality / price at the first
CORE_LEVELS = 2  # how many of the last levels fetch only the first key tier
FACTORS = (1.0, 1.4, 2.0, 2.8, 4.0, 5.6)  # on the steps, tried for lower rungs
SHARES = (0.0, 0.15, 0.3, 0.45, 0.6, 0.75)  # of the updates that a level withholds, tried
RANKED_FRAMES = 6  # frames of a group that tell which updates matter

Levels = tuple[tuple[float, float], ...]  # pruned share and step factor of each level


def choose_tiers(subject: Subject, steps: StepSettings, levels: int) -> tuple[tuple[float, ...], int]:
    """Share of the rows in each key tier, and how many of the last of `levels` levels fetch only the first tier.

    A byte costs more in these levels, so that they can do without more rows.
    """
    core = min(CORE_LEVELS, levels - 1)
    if not (core and subject.layout.removal_error > 0):
        return subject.settings.tiers, 0
    allowed = [steps.rows * price**0.5 for price in (LEVEL_PRICES[0], LEVEL_PRICES[-CORE_LEVELS])]
    rows, fewer = (len(subject.pruning.within(a).rows) for a in allowed)
    return (fewer / rows, 1 - fewer / rows), core


def choose_key_factors(sample: CalibrationSample, steps: StepSettings, price: float) -> tuple[float, ...]:
    """Factors on the key steps: 1, and the coarser one that is cheapest at KEY_PRICE.

    States are differences to the first key quality, so rows that move have only the error that the second one adds.
    """
    coded = [sample.code_key(steps, factor) for factor in FACTORS]
    errors = [sample.states(base, steps)[0] for _, base in coded]
    added = [np.where(sample.moving, error - errors[0], error)[None] for error in errors]
    costs = [sample.error(error, steps).sum() for error in added]
    return 1.0, FACTORS[1 + _cheapest([size for size, _ in coded[1:]], costs[1:], KEY_PRICE * price)]


def choose_levels(sample: CalibrationSample, subject: Subject, steps: StepSettings, price: float) -> Levels:
    """The cheapest pruned share and step factor at each of LEVEL_PRICES; the factor of the first level is 1."""
    only = ((0.0, 1.0),)
    if not sample.moving.any():
        return only
    states = sample.states(sample.code_key(steps, 1.0)[1], steps)
    coded = [sample.code_states(states, factor) for factor in FACTORS]
    if coded[0][0] == 0:  # no channel has a plane
        return only
    score, withheld = _withhold_updates(subject, steps)
    depths = assign_depths(score[sample.index], sample.moving, SHARES)
    still = sample.error(states[0][None], steps)
    sizes, errors = np.empty((len(SHARES), len(FACTORS))), np.empty((len(SHARES), len(FACTORS)))
    for i in range(len(SHARES)):
        kept = sample.moving & (depths >= i)
        part = replace(sample, moving=kept).code_states(states, 1.0)[0] / coded[0][0]
        for k, (size, error) in enumerate(coded):
            sizes[i, k] = part * size
            errors[i, k] = withheld[i] + np.where(kept, sample.error(error, steps), still).sum()
    return _descend(sizes, errors, price)


def _descend(sizes: NDArray[np.float64], errors: NDArray[np.float64], price: float) -> Levels:
    """The cheapest pair for each of LEVEL_PRICES, each at least as pruned and coarse as the one before.

    `sizes` and `errors` are SHARES x FACTORS.
    """
    levels = [(SHARES[_cheapest(sizes[:, 0], errors[:, 0], price)], 1.0)]
    for factor in LEVEL_PRICES[1:]:
        i, k = divmod(_cheapest(sizes, errors, factor * price), len(FACTORS))
        level = max(SHARES[i], levels[-1][0]), max(FACTORS[k], levels[-1][1])
        levels += [level] if level != levels[-1] else []
    return tuple(levels)


def _withhold_updates(subject: Subject, steps: StepSettings) -> tuple[NDArray[np.float64], list[float]]:
    """(N,) score of the group's rows, and the rendered error of withholding each of SHARES of the updates."""
    canonical = subject.canonical()
    ranked = [subject.frames[i].take(subject.layout.rows) for i in evenly_spaced(len(subject.frames), RANKED_FRAMES)]
    score, moving = _rank(subject, steps, [canonical, *ranked])
    depths = assign_depths(score, moving, SHARES)
    pictures = pair_with_cameras([ranked[i] for i in evenly_spaced(len(ranked), PICTURES)], subject.cameras)
    full = [render(frame, camera).rgb for frame, camera in pictures]
    errors = []
    for i in range(len(SHARES)):
        updated = (moving & (depths >= i)) | ~moving
        held = [render(_mix(frame, canonical, updated), camera).rgb for frame, camera in pictures]
        errors.append(float(np.mean([mse(a, b) for a, b in zip(held, full, strict=True)])))
    return score, errors


def _rank(
    subject: Subject, steps: StepSettings, frames: Sequence[Gaussians]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """`rank_updates` of all N rows at `steps`; `frames` are the canonical one and those that are ranked."""
    layout, settings = subject.layout, subject.settings
    layout = replace(layout, key_steps=steps.key, state_steps=steps.state)
    channels = key_channels(frames[0], layout.transform, steps.key).astype(np.float32)
    base = layout.canonical_space(channels, np.zeros(len(layout.codes), np.uint8))
    states = state_channels(frames, base, steps.state)
    states /= STATE.steps(steps.state, layout.colours)[:, None]
    changes = states - states[0]
    known = layout.usage if settings.update_rank == "usage" else None
    return rank_updates(states[1:], changes[1:], layout.state_weights(), known, settings.keep_all)


def _mix(frame: Gaussians, canonical: Gaussians, updated: NDArray[np.bool_]) -> Gaussians:
    """`frame` where updated, else `canonical`."""
    columns = [(getattr(frame, f.name), getattr(canonical, f.name)) for f in fields(Gaussians)]
    return Gaussians(*(np.where(updated.reshape(-1, *[1] * (a.ndim - 1)), a, b) for a, b in columns))


def _cheapest(sizes: ArrayLike, errors: ArrayLike, price: float) -> int:
    """Flat index of the least error + price * bytes."""
    return int(np.argmin(np.asarray(errors) + price * np.asarray(sizes)))

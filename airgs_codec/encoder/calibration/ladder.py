"""Levels and key tiers of one scene, from small encodes of one of its groups. N rows of the group."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.importance import pooled_error
from airgs_codec.coding.channels import key_channels, state_channels
from airgs_codec.coding.steps import StepSettings
from airgs_codec.encoder.calibration.sample import CalibrationSample
from airgs_codec.encoder.calibration.subject import Subject
from airgs_codec.encoder.levels import assign_depths
from airgs_codec.encoder.rank import rank_updates
from airgs_codec.encoder.settings import LevelSettings
from airgs_codec.media.metrics import mse
from airgs_codec.package.layout import STATE
from airgs_codec.render import render
from airgs_codec.scene.gaussians import Gaussians

# Of each level: the factor on every step, its key quality, its key tiers. A rung costs what a package with only that
# rung would: all steps grow alike, and with their square the price of a byte.
LEVELS = ((1.0, 0, 2), (1.5, 1, 2), (2.1, 1, 2), (3.1, 2, 1), (4.5, 2, 1))
SHARES = (0.0, 0.2, 0.4, 0.6, 0.75, 0.87)  # of the updates that a level withholds, tried
RANKED_FRAMES = 6  # frames of a group that tell which updates matter


def choose_tiers(subject: Subject, steps: StepSettings) -> tuple[float, ...]:
    """Share of the rows in each key tier: the first has what its levels need, by the error that they may make."""
    if subject.layout.removal_error == 0:
        return subject.settings.tiers
    core = min(factor for factor, _, tiers in LEVELS if tiers == 1)
    rows, fewer = (len(subject.pruning.within(steps.rows * factor).rows) for factor in (1.0, core))
    return fewer / rows, 1 - fewer / rows


def key_factors() -> tuple[float, ...]:
    """Factors on the key steps: of each key quality the geometric mean of its levels' factors."""
    qualities = sorted({quality for _, quality, _ in LEVELS})
    return tuple(float(np.exp(np.mean([np.log(f) for f, q, _ in LEVELS if q == quality]))) for quality in qualities)


def choose_levels(
    sample: CalibrationSample, subject: Subject, steps: StepSettings, price: float
) -> tuple[LevelSettings, ...]:
    """The levels of LEVELS, each with the cheapest share of the updates to withhold; one alone if nothing moves."""
    only = (LevelSettings(0.0),)
    if not sample.moving.any():
        return only
    states = sample.states(sample.code_key(steps, 1.0)[1], steps)
    coded = [sample.code_states(states, factor) for factor, _, _ in LEVELS]
    if coded[0][0] == 0:  # no channel has a plane
        return only
    score, withheld = _withhold_updates(subject, steps)
    depths = assign_depths(score[sample.index], sample.moving, SHARES)
    kept = [sample.moving & (depths >= i) for i in range(len(SHARES))]
    parts = [replace(sample, moving=rows).code_states(states, 1.0)[0] / coded[0][0] for rows in kept]
    still = sample.error(states[0][None], steps)
    levels: list[LevelSettings] = []
    for (factor, quality, tiers), (size, error) in zip(LEVELS, coded, strict=True):
        shown = [np.where(rows, sample.error(error, steps), still * factor**2).sum() for rows in kept]
        costs = [w + e + factor**2 * price * part * size for w, e, part in zip(withheld, shown, parts, strict=True)]
        share = max(SHARES[int(np.argmin(costs))], levels[-1].pruned if levels else 0.0)
        levels.append(LevelSettings(share, factor, tiers, quality))
    return tuple(levels)


def _withhold_updates(subject: Subject, steps: StepSettings) -> tuple[NDArray[np.float64], list[float]]:
    """(N,) score of the group's rows, and the rendered error of withholding each of SHARES of the updates."""
    canonical = subject.canonical()
    ranked = [subject.frames[i].take(subject.layout.rows) for i in evenly_spaced(len(subject.frames), RANKED_FRAMES)]
    score, moving = _rank(subject, steps, [canonical, *ranked])
    depths = assign_depths(score, moving, SHARES)
    pictures = [(subject.frames[t].take(subject.layout.rows), camera) for t, camera in subject.layout.pictures]
    full = [render(frame, camera).rgb for frame, camera in pictures]
    errors = []
    for i in range(len(SHARES)):
        updated = (moving & (depths >= i)) | ~moving
        held = [render(_mix(frame, canonical, updated), camera).rgb for frame, camera in pictures]
        errors.append(pooled_error([mse(a, b) for a, b in zip(held, full, strict=True)]))
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

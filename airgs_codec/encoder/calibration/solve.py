"""Steps and ladder of one scene, from small encodes of one of its groups.

A step is worth halving while that lowers the error of pictures by more than its bytes would elsewhere: Lagrange's
condition with one multiplier for all choices (Everett 1963), here the price of a byte in squared error.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.importance import PICTURES, Removal, in_turn
from airgs_codec.coding.channels import dequantise_key, key_channels, state_channels
from airgs_codec.coding.steps import StepSettings, world_steps
from airgs_codec.encoder.calibration.sample import BLOCK_ROWS, Cost, Sample
from airgs_codec.encoder.levels import assign_depths
from airgs_codec.encoder.plan import GroupPlan, Survey, plan_group, rank_updates
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.media.metrics import mse
from airgs_codec.package import tables
from airgs_codec.package.layout import KEY, STATE
from airgs_codec.render import Camera, render
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence

REVISION = 1  # of this method, for the cache
TRIAL = 1.5  # factor between the two steps at which bytes and error are measured
PRIOR = 0.02  # share of all bytes and error that every step is taken to have: what is hardly measured hardly moves
LEVEL_PRICES = (1.0, 2.5, 6.0, 12.0)  # of a byte at each level, in those of the top one
KEY_PRICE = 7.0  # the same at the second key quality
CORE_LEVELS = 2  # the last ones, for which the first key tier must do
FACTORS = (1.0, 1.4, 2.0, 2.8, 4.0, 5.6)  # of the steps, tried for lower rungs
SHARES = (0.0, 0.15, 0.3, 0.45, 0.6, 0.75)  # of the updates, tried to withhold
SAMPLE_BLOCKS, FEWEST_BLOCKS, MOST_FRAMES = 150, 5, 32  # of the sample: blocks of all its frames together
RANKED_FRAMES = 6  # of a group, to tell which updates matter

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


@dataclass(frozen=True, slots=True)
class Calibration:
    """What a scene asks for at quality 1."""

    steps: StepSettings
    levels: tuple[tuple[float, float], ...]  # pruned share, step factor
    core_levels: int
    tiers: tuple[float, ...]
    key_factors: tuple[float, ...]
    byte_price: float  # squared error of pictures that a byte a frame must save

    def apply(self, settings: EncodeSettings) -> EncodeSettings:
        """Settings of an encode: what `settings.calibrate` asks for is replaced, and nothing is left to calibrate."""
        ladder = settings.calibrate == "ladder"
        chosen = replace(
            settings, calibrate="none", steps=self.steps, key_factors=self.key_factors, byte_price=self.byte_price
        )
        if not ladder:
            return chosen
        return replace(chosen, levels=self.levels, core_levels=self.core_levels, tiers=self.tiers)


@dataclass(frozen=True, slots=True, eq=False)
class Subject:
    """The group that is calibrated on."""

    frames: list[Gaussians]
    plan: GroupPlan
    cameras: Sequence[Camera]  # training views
    removal: Removal
    settings: EncodeSettings

    @staticmethod
    def of(
        sequence: GaussianSequence, survey: Survey, cameras: Sequence[Camera], given: bool, settings: EncodeSettings
    ) -> Subject:
        """Planned at `settings`."""
        frames = sequence.load(range(survey.start, survey.stop)).frames
        removal = Removal([frames[i - survey.start] for i in survey.shown], cameras, survey.rank)
        plan = plan_group(sequence, survey, cameras, given, settings, removal)
        return Subject(frames, plan, cameras, removal, settings)

    def sample(self, fps: float) -> Sample:
        """Blocks spread over all rows, and the frames of the first segment: enough to see P and B pictures settle."""
        plan, settings = self.plan, self.settings
        canonical = plan.canonical - plan.start
        segment = min(len(self.frames), MOST_FRAMES, max(1, int(settings.segment_s * fps)))
        most = max(FEWEST_BLOCKS, SAMPLE_BLOCKS // segment)
        blocks = np.array(evenly_spaced(-(-len(plan.rows) // BLOCK_ROWS), most))
        index = (blocks[:, None] * BLOCK_ROWS + np.arange(BLOCK_ROWS)).ravel()
        index = index[index < len(plan.rows)]
        sample = Sample(
            index=index,
            key=self.frames[canonical].take(plan.rows[index]),
            frames=[frame.take(plan.rows[index]) for frame in self.frames[:segment]],
            classes=plan.classes[index],
            sensitivity=plan.sensitivity.take(index),
            moving=np.ones(len(index), bool),
            scale=len(plan.rows) / len(index),
            group=len(self.frames),
            segment=segment,
        )
        states = sample.states(sample.code_key(settings.steps, 1.0)[1], settings.steps)
        part = replace(plan, classes=sample.classes, sensitivity=sample.sensitivity, score=plan.score[index])
        return replace(sample, moving=rank_updates(states[1:], states[1:] - states[0], part, settings)[1])


def calibrate(
    sequence: GaussianSequence, survey: Survey, cameras: Sequence[Camera], given: bool, settings: EncodeSettings
) -> Calibration:
    """Starts at `settings.steps`, quality 1. `cameras` are the training views."""
    subject = Subject.of(sequence, survey, cameras, given, replace(settings, quality=1.0))
    sample = subject.sample(float(sequence.fps))
    steps, price = solve_steps(sample, subject)
    levels = choose_levels(sample, subject, steps, price)
    tiers, core = choose_tiers(subject, steps, len(levels))
    return Calibration(steps, levels, core, tiers, choose_key_factors(sample, steps, price), price)


def get_step(steps: StepSettings, name: str) -> float:
    """By its name in STEPS, or "rows"."""
    side, _, attribute = name.partition(".")
    return float(getattr(getattr(steps, side), attribute) if attribute else getattr(steps, side))


def with_step(steps: StepSettings, name: str, value: float) -> StepSettings:
    """The same steps but one."""
    side, _, attribute = name.partition(".")
    changed: Any = replace(getattr(steps, side), **{attribute: value}) if attribute else value
    return replace(steps, **{side: changed})


def solve_steps(sample: Sample, subject: Subject) -> tuple[StepSettings, float]:
    """Steps of one price that together make the error that `subject.settings.steps` make, and the price.

    Bytes fall with the logarithm of a step, at m; its error is b times its square. With factors f, sum b f^2 stays and
    bytes are least where f^2 = (m / sum m) / (b / sum b); a byte then costs 2 sum b / sum m.
    """
    steps = subject.settings.steps
    names = [n for n in STEPS if subject.frames[0].sh_rest.shape[1] or not n.endswith("sh_rest")]

    def trial(name: str, factor: float) -> Cost:
        return sample.cost(with_step(steps, name, get_step(steps, name) * factor), (STEPS[name],))

    with ThreadPoolExecutor(subject.settings.jobs) as pool:
        finer = list(pool.map(trial, names, itertools.repeat(1 / TRIAL)))
        coarser = list(pool.map(trial, names, itertools.repeat(TRIAL)))
    slopes = {}
    for name, was, now in zip(names, finer, coarser, strict=True):
        grows = now.state_error - was.state_error + now.key_error - was.key_error
        slopes[name] = (was.bytes - now.bytes) / np.log(TRIAL**2), grows / (TRIAL**2 - TRIAL**-2)
    if subject.plan.removal_error > 0:
        fewer, error = _without_rows(sample, subject)
        saved = sample.cost(steps).bytes - fewer.bytes
        slopes["rows"] = saved / np.log(TRIAL), (error - subject.plan.removal_error) / (TRIAL**2 - 1)
    slopes = {name: (max(m, 0.0), max(b, 0.0)) for name, (m, b) in slopes.items()}
    rate, error = sum(m for m, _ in slopes.values()), sum(b for _, b in slopes.values())
    if rate == 0 or error == 0:
        return steps, 0.0
    for name, (m, b) in slopes.items():
        factor = ((m / rate + PRIOR) / (b / error + PRIOR)) ** 0.5
        steps = with_step(steps, name, float(f"{get_step(steps, name) * factor:.4g}"))
    return steps, 2 * error / rate


def _without_rows(sample: Sample, subject: Subject) -> tuple[Cost, float]:
    """Cost of the sample, and the error of pictures, when rows left out may cost TRIAL times as much."""
    needed = subject.removal.needed(subject.settings.steps.rows * TRIAL)
    kept = np.isin(subject.plan.rows[sample.index], needed.rows)
    return sample.take(kept).cost(subject.settings.steps), needed.error


def choose_tiers(subject: Subject, steps: StepSettings, levels: int) -> tuple[tuple[float, ...], int]:
    """Share of the rows in each key tier, and how many levels do without the last one.

    Their byte costs more, so they can do without more rows.
    """
    core = min(CORE_LEVELS, levels - 1)
    if not (core and subject.plan.removal_error > 0):
        return subject.settings.tiers, 0
    allowed = [steps.rows * price**0.5 for price in (LEVEL_PRICES[0], LEVEL_PRICES[-CORE_LEVELS])]
    rows, fewer = (len(subject.removal.needed(a).rows) for a in allowed)
    return (fewer / rows, 1 - fewer / rows), core


def choose_key_factors(sample: Sample, steps: StepSettings, price: float) -> tuple[float, ...]:
    """1, and a coarser one for KEY_PRICE; states are differences to the first, so its error is not theirs."""
    sizes, errors = [], []
    first: NDArray[np.float64] | None = None
    for factor in FACTORS:
        size, base = sample.code_key(steps, factor)
        error = sample.states(base, steps)[0]
        first = error if first is None else first
        sizes.append(size)
        errors.append(sample.error(np.where(sample.moving, error - first, error)[None], steps).sum())
    return 1.0, FACTORS[1 + _cheapest(sizes[1:], errors[1:], KEY_PRICE * price)]


def choose_levels(
    sample: Sample, subject: Subject, steps: StepSettings, price: float
) -> tuple[tuple[float, float], ...]:
    """Pruned share and step factor for each of LEVEL_PRICES, from all pairs; the first has factor 1."""
    if not sample.moving.any():
        return ((0.0, 1.0),)
    score, withheld = _withheld(subject, steps)
    depths = assign_depths(score[sample.index], sample.moving, SHARES)
    states = sample.states(sample.code_key(steps, 1.0)[1], steps)
    coded = [sample.code_states(states, factor) for factor in FACTORS]
    if coded[0][0] == 0:  # no channel has a plane
        return ((0.0, 1.0),)
    still = sample.error(states[0][None], steps)
    sizes, errors = np.empty((len(SHARES), len(FACTORS))), np.empty((len(SHARES), len(FACTORS)))
    for i in range(len(SHARES)):
        kept = sample.moving & (depths >= i)
        part = replace(sample, moving=kept).code_states(states, 1.0)[0] / coded[0][0]
        for k, (size, error) in enumerate(coded):
            sizes[i, k] = part * size
            errors[i, k] = withheld[i] + np.where(kept, sample.error(error, steps), still).sum()
    levels = [(SHARES[_cheapest(sizes[:, 0], errors[:, 0], price)], 1.0)]
    for factor in LEVEL_PRICES[1:]:
        i, k = divmod(_cheapest(sizes, errors, factor * price), len(FACTORS))
        level = max(SHARES[i], levels[-1][0]), max(FACTORS[k], levels[-1][1])
        levels += [level] if level != levels[-1] else []
    return tuple(levels)


def _withheld(subject: Subject, steps: StepSettings) -> tuple[NDArray[np.float64], list[float]]:
    """(N,) score of the group's rows, and the rendered error of withholding each of SHARES of the updates."""
    plan, frames = subject.plan, subject.frames
    canonical = frames[plan.canonical - plan.start].take(plan.rows)
    settings = replace(subject.settings, steps=steps)
    key_steps, state_steps, _ = world_steps(steps, 1.0)
    colours = plan.key_values.shape[0] - KEY.colour_start
    transform = tables.unpack_matrix(plan.transform, colours)
    channels = key_channels(canonical, transform, key_steps).astype(np.float32)
    still = np.zeros(len(plan.codes), np.uint8)
    base = dequantise_key(channels, plan.codes, plan.classes, still, transform, plan.grid, key_steps)
    ranked = [frames[i].take(plan.rows) for i in evenly_spaced(len(frames), RANKED_FRAMES)]
    states = state_channels([canonical, *ranked], base, state_steps)
    states /= STATE.steps(state_steps, colours)[:, None]
    changes = states - states[0]
    score, moving = rank_updates(states[1:], changes[1:], replace(plan, state_steps=state_steps), settings)
    depths = assign_depths(score, moving, SHARES)
    pictures = in_turn([ranked[i] for i in evenly_spaced(len(ranked), PICTURES)], subject.cameras)
    full = [render(frame, camera).rgb for frame, camera in pictures]
    errors = []
    for i in range(len(SHARES)):
        updated = (moving & (depths >= i)) | ~moving
        held = [render(_mix(frame, canonical, updated), camera).rgb for frame, camera in pictures]
        errors.append(float(np.mean([mse(a, b) for a, b in zip(held, full, strict=True)])))
    return score, errors


def _mix(frame: Gaussians, canonical: Gaussians, updated: NDArray[np.bool_]) -> Gaussians:
    """`frame` where updated, else `canonical`."""
    columns = [(getattr(frame, f.name), getattr(canonical, f.name)) for f in fields(Gaussians)]
    return Gaussians(*(np.where(updated.reshape(-1, *[1] * (a.ndim - 1)), a, b) for a, b in columns))


def _cheapest(sizes: ArrayLike, errors: ArrayLike, price: float) -> int:
    """Flat index of the least error + price * bytes."""
    return int(np.argmin(np.asarray(errors) + price * np.asarray(sizes)))

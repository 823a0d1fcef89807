"""Plan of a group before anything is coded: rows, tiers, order, steps, grid, colour transform.

N rows of a group, n rows of a tier or level, P planes, C colour channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from airgs_codec import canonical as space
from airgs_codec import manifest as tables
from airgs_codec import transforms as tf
from airgs_codec.errors import SceneError
from airgs_codec.gaussians import Gaussians
from airgs_codec.leaveout import Needed, Removal, importance
from airgs_codec.manifest import Atlas, Grid, KeySteps, StateSteps
from airgs_codec.render import Camera
from airgs_codec.sensitivity import CODING_VARIANCE, FLOOR, LEAK, Sensitivity, measure_sensitivity, withheld_error
from airgs_codec.sequence import Repaired, repair
from airgs_codec.sequence import Sequence as GaussianSequence
from airgs_codec.settings import EncodeSettings, StepSettings
from airgs_codec.tiers import assign_tiers
from airgs_codec.usage import Usage, measure_usage


@dataclass(slots=True, eq=False)
class GroupPlan:
    """What is known of a group while it is coded; fields fill up from top to bottom."""

    start: int
    stop: int
    canonical: int
    rows: NDArray[np.intp]  # (N,) input rows in file order, unused ones left out
    count: int  # input rows after repairs
    removal_error: float  # of pictures without the rows left out
    notes: list[str]
    tiers: NDArray[np.uint8]  # (N,) of the rows in file order, ascending
    score: NDArray[np.float64]  # (N,) usage
    codes: NDArray[np.uint64]  # (N,) Morton codes of the grid
    classes: NDArray[np.int16]  # (N,) motion classes
    sensitivity: Sensitivity  # of the rows in file order
    grid: Grid
    key_steps: KeySteps
    state_steps: StateSteps
    transform: str
    key_values: NDArray[np.float64]  # (7 + C, N)
    key_atlases: list[list[Atlas]] = field(default_factory=list)  # tier x quality
    key_samples: list[list[NDArray[np.uint8]]] = field(default_factory=list)  # (P, n)
    key_bases: list[list[NDArray[np.int32]]] = field(default_factory=list)
    depths: NDArray[np.uint8] = field(default_factory=lambda: np.empty(0, np.uint8))
    numbers: list[int] = field(default_factory=list)  # of the key unit in each tier; 0: no rows
    levels: list[Atlas] = field(default_factory=list)

    def tier_rows(self, tier: int) -> slice:
        """Rows of a tier, in file order."""
        low, high = np.searchsorted(self.tiers, [tier, tier + 1])
        return slice(int(low), int(high))


def scene_unit(g: Gaussians) -> float:
    """Opacity-weighted median size of a Gaussian: what lengths are measured in, in world units."""
    size = g.log_scales.astype(np.float64).mean(axis=1)
    order = np.argsort(size)
    weight = np.cumsum(g.opacities().astype(np.float64)[order])
    if weight[-1] <= 0:  # nothing is visible: every size counts alike
        return float(np.exp(np.median(size)))
    return float(np.exp(size[order][np.searchsorted(weight, weight[-1] / 2)]))


def load_frames(sequence: GaussianSequence, start: int, stop: int) -> Repaired:
    """Frames [start, stop) after repairs."""
    where = f"{sequence.folder.name} frames {start}-{stop - 1}"
    return repair([sequence.read(i) for i in range(start, stop)], where)


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """What the training views say about the rows of a group, before any setting matters."""

    start: int
    stop: int
    canonical: int  # the middle frame
    shown: list[int]  # frames that were looked at
    usage: Usage
    sensitivity: Sensitivity
    rank: NDArray[np.float64]  # (N,) of `leaveout.importance`


def survey_group(sequence: GaussianSequence, start: int, stop: int, cameras: Sequence[Camera]) -> Survey:
    """Usage and sensitivity over the first, canonical and last frame."""
    canonical = start + (stop - start) // 2
    shown = sorted({start, canonical, stop - 1})
    loaded = load_frames(sequence, start, stop).frames
    frames = [loaded[i - start] for i in shown]
    usage, sensitivity = measure_usage(frames, cameras), measure_sensitivity(frames, cameras)
    return Survey(start, stop, canonical, shown, usage, sensitivity, importance(frames, usage, sensitivity))


def plan_group(
    sequence: GaussianSequence, survey: Survey, cameras: Sequence[Camera], given: bool, settings: EncodeSettings
) -> GroupPlan:
    """Order, tiers, steps and transforms of a group, from its canonical frame."""
    loaded = load_frames(sequence, survey.start, survey.stop)
    key = loaded.frames[survey.canonical - survey.start]
    if given and not settings.keep_all:
        shown = [loaded.frames[i - survey.start] for i in survey.shown]
        needed = Removal(shown, cameras, survey.rank).needed(settings.steps.rows * settings.quality)
    else:
        needed = Needed(np.arange(len(key)), 0.0)
    score = survey.rank if settings.usage == "importance" else survey.usage.measure(settings.usage)
    kept = key.take(needed.rows)
    key_steps, state_steps, grid_step = world_steps(settings.steps, settings.quality, scene_unit(kept))
    grid = _grid(kept.means, grid_step)
    codes = space.grid_codes(kept.means, grid)
    tiers = assign_tiers(score[needed.rows], settings.tiers)
    order = np.lexsort((codes, tiers))
    rows = needed.rows[order]
    key = key.take(rows)
    transform = colour_transform(key, key_steps)
    channels = 3 * (1 + key.sh_rest.shape[1])
    sensitivity = survey.sensitivity.take(rows)
    values = space.key_channels(key, tables.unpack_matrix(transform, channels), key_steps)
    return GroupPlan(
        survey.start,
        survey.stop,
        survey.canonical,
        rows,
        len(score),
        needed.error,
        loaded.notes,
        tiers[order],
        score[rows],
        codes[order],
        _motion_classes(sensitivity),
        sensitivity,
        grid,
        key_steps,
        state_steps,
        transform,
        values,
    )


def _motion_classes(sensitivity: Sensitivity) -> NDArray[np.int16]:
    seen = sensitivity.means[sensitivity.means > 0]
    if not len(seen):  # nothing is visible: every row counts alike
        return np.zeros(len(sensitivity.means), np.int16)
    return tf.motion_classes(sensitivity.means, FLOOR * float(np.median(seen)))


def world_steps(steps: StepSettings, quality: float, unit: float) -> tuple[KeySteps, StateSteps, float]:
    """Steps of key and state, and the grid's in world units; `unit` of the scene."""
    key = KeySteps(*(getattr(steps.key, name) * quality for name in tables.KEY_ATTRIBUTES))
    state = StateSteps(*(getattr(steps.state, name) * quality for name in tables.STATE_ATTRIBUTES))
    return key, state, steps.grid * quality * unit


def _grid(means: NDArray[np.float32], step: float) -> Grid:
    """The finest cubic grid of at most 21 bits an axis whose step is at least `step`."""
    low, high = means.min(axis=0).astype(np.float64), means.max(axis=0).astype(np.float64)
    extent = float((high - low).max())
    if not np.isfinite(extent) or extent > 1e30:
        raise SceneError(f"means span {extent:g} world units: expected at most 1e30")
    bits = min(21, max(1, int(extent / step + 1).bit_length()))
    return Grid(low.tolist(), max(step, extent / (2**bits - 1)), bits)


def colour_transform(key: Gaussians, steps: KeySteps) -> str:
    """The KLT of a group's colours, as airgs.json stores it."""
    colour = tf.colours(key.sh_dc, key.sh_rest).astype(np.float64)
    scaled = colour / tf.colour_steps(steps.sh_dc, steps.sh_rest, colour.shape[1])
    return tables.pack_matrix(tf.fit_colour_transform(scaled))


def rank_updates(
    states: NDArray[np.float64], changes: NDArray[np.float64], plan: GroupPlan, settings: EncodeSettings
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(N,) score of rows for pruning and (N,) whether any level carries them; arguments (T, 10 + C, N) in steps.

    `states` are differences to the canonical frame as decoded, `changes` to the original one. A row is static if it
    never changes by more than half a step, or if coding its states is expected to add more error than it mends.
    """
    transform = tables.unpack_matrix(plan.transform, states.shape[1] - space.STATE_FIXED)
    withheld = partial(
        withheld_error, classes=plan.classes, s=plan.sensitivity, steps=plan.state_steps, transform=transform
    )
    moving = np.abs(changes).max(axis=(0, 1)) > 0.5
    if not settings.keep_all:
        variance = np.square(states).mean(axis=0, keepdims=True)
        coded = np.minimum(variance + LEAK * np.maximum(CODING_VARIANCE - variance, 0), CODING_VARIANCE)
        moving &= withheld(states) > withheld(np.sqrt(coded))
    if settings.rank == "error":
        return withheld(changes), moving
    return plan.score * np.sqrt(np.einsum("tcn,tcn->n", changes, changes) / len(changes)), moving

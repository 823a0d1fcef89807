"""Plan of a group before anything is coded: rows, tiers, order, steps, grid, colour transform.

N rows of a group, n rows of a tier or level, P planes, C colour channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from airgs_codec.analysis.grouping import middle_frame
from airgs_codec.analysis.importance import Needed, Removal, importance
from airgs_codec.analysis.sensitivity import CODING_VARIANCE, LEAK, Sensitivity, measure_sensitivity
from airgs_codec.analysis.usage import measure_usage
from airgs_codec.coding.channels import key_channels
from airgs_codec.coding.colour import colour_transform
from airgs_codec.coding.grid import fit_grid, grid_codes
from airgs_codec.coding.motion import classify_motion
from airgs_codec.coding.steps import world_steps
from airgs_codec.coding.weights import channel_weights, withheld_error
from airgs_codec.encoder.error_bounds import Sent, max_error
from airgs_codec.encoder.levels import assign_tiers
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.package import tables
from airgs_codec.package.layout import KEY, STATE
from airgs_codec.package.tables import Atlas, Grid, KeySteps, LeftOut, StateSteps
from airgs_codec.render import Camera
from airgs_codec.scene.sequence import GaussianSequence
from airgs_codec.scene.usage import Usage


@dataclass(slots=True, eq=False)
class GroupPlan:
    """What is known of a group while it is coded; fields fill up from top to bottom."""

    index: int  # of the group
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
    moved: NDArray[np.float64] | None  # (N,) `Usage.moved` of the rows, where it is known
    sensitivity: Sensitivity  # of the rows in file order
    grid: Grid
    key_steps: KeySteps
    state_steps: StateSteps
    transform: str
    key_values: NDArray[np.float64]  # (7 + C, N)
    key_atlases: list[list[Atlas]] = field(default_factory=list)  # tier x quality
    key_samples: list[list[NDArray[np.uint8]]] = field(default_factory=list)  # (P, n)
    key_bases: list[list[NDArray[np.int32]]] = field(default_factory=list)
    key_sent: list[list[Sent | None]] = field(default_factory=list)  # tier x quality
    depths: NDArray[np.uint8] = field(default_factory=lambda: np.empty(0, np.uint8))
    numbers: list[int] = field(default_factory=list)  # of the key unit in each tier; 0: no rows
    levels: list[Atlas] = field(default_factory=list)
    level_sent: list[Sent | None] = field(default_factory=list)
    left_out: list[LeftOut] = field(default_factory=list)

    def weights(self) -> NDArray[np.float64]:
        """(10 + C, N) of `sensitivity.channel_weights`."""
        transform = tables.unpack_matrix(self.transform, len(self.key_values) - KEY.colour_start)
        return channel_weights(self.classes, self.sensitivity, self.state_steps, transform)

    def key_weights(self) -> NDArray[np.float64]:
        """(7 + C, N) the same for the channels of a key."""
        steps = StateSteps(1.0, *(getattr(self.key_steps, name) for name in tables.KEY_ATTRIBUTES))
        transform = tables.unpack_matrix(self.transform, len(self.key_values) - KEY.colour_start)
        return channel_weights(self.classes, self.sensitivity, steps, transform)[3:]

    def bound_key(self, tier: int, quality: int, differences: list[NDArray[np.uint8]]) -> None:
        """Fill in the errors of a key atlas whose picture decodes that far off."""
        atlas, sent = self.key_atlases[tier][quality], self.key_sent[tier][quality]
        errors = max_error(atlas, sent, differences, False) if sent else [0.0] * len(KEY.attributes)
        self.key_atlases[tier][quality] = replace(atlas, max_error=errors)

    def bound_level(self, level: int, differences: list[NDArray[np.uint8]]) -> None:
        """The same for the segments of a level; where none is sent, there is no error to speak of."""
        atlas, sent = self.levels[level], self.level_sent[level]
        errors = max_error(atlas, sent, differences, True) if sent and differences else [0.0] * len(STATE.attributes)
        self.levels[level] = replace(atlas, max_error=errors)

    def leave_out(self, what: str, count: int, error: float, size: float) -> None:
        """Note a decision."""
        if count:
            self.left_out.append(LeftOut(what, self.index, count, float(f"{error:.3g}"), float(f"{size:.3g}")))

    def tier_rows(self, tier: int) -> slice:
        """Rows of a tier, in file order."""
        low, high = np.searchsorted(self.tiers, [tier, tier + 1])
        return slice(int(low), int(high))


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """What the training views say about the rows of a group, before any setting matters."""

    index: int  # of the group
    start: int
    stop: int
    canonical: int  # the middle frame
    shown: list[int]  # frames that were looked at
    usage: Usage
    sensitivity: Sensitivity
    rank: NDArray[np.float64]  # (N,) of `leaveout.importance`


def survey_group(sequence: GaussianSequence, index: int, start: int, stop: int, cameras: Sequence[Camera]) -> Survey:
    """Usage and sensitivity over the first, canonical and last frame; the trainer's usage, over all, where it fits."""
    canonical = middle_frame(start, stop)
    shown = sorted({start, canonical, stop - 1})
    loaded = sequence.load(range(start, stop)).frames
    frames = [loaded[i - start] for i in shown]
    known = sequence.usage(start, stop)
    usage = known if known is not None and len(known.peak) == len(loaded[0]) else measure_usage(frames, cameras)
    sensitivity = measure_sensitivity(frames, cameras)
    return Survey(index, start, stop, canonical, shown, usage, sensitivity, importance(frames, usage, sensitivity))


def plan_group(
    sequence: GaussianSequence,
    survey: Survey,
    cameras: Sequence[Camera],
    given: bool,
    settings: EncodeSettings,
    removal: Removal | None = None,
) -> GroupPlan:
    """Order, tiers, steps and transforms of a group, from its canonical frame.

    `given`: the cameras are the scene's own, so that rows they can do without are left out. `removal` saves time if
    somebody has it.
    """
    loaded = sequence.load(range(survey.start, survey.stop))
    key = loaded.frames[survey.canonical - survey.start]
    if given and not settings.keep_all:
        removal = removal or Removal([loaded.frames[i - survey.start] for i in survey.shown], cameras, survey.rank)
        needed = removal.needed(settings.steps.rows * settings.quality)
    else:
        needed = Needed(np.arange(len(key)), 0.0)
    score = survey.rank if settings.usage == "importance" else survey.usage.measure(settings.usage)
    kept = key.take(needed.rows)
    key_steps, state_steps, cell = world_steps(settings.steps, settings.quality)
    classes = classify_motion(survey.sensitivity.take(needed.rows), kept)
    grid = fit_grid(kept.means, classes, cell)
    codes = grid_codes(kept.means, classes, grid)
    tiers = assign_tiers(score[needed.rows], settings.tiers)
    order = np.lexsort((codes, tiers))
    rows = needed.rows[order]
    key = key.take(rows)
    transform = colour_transform(key, key_steps)
    channels = 3 * (1 + key.sh_rest.shape[1])
    sensitivity = survey.sensitivity.take(rows)
    values = key_channels(key, tables.unpack_matrix(transform, channels), key_steps)
    return GroupPlan(
        survey.index,
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
        classes[order],
        None if survey.usage.moved is None else survey.usage.moved[rows],
        sensitivity,
        grid,
        key_steps,
        state_steps,
        transform,
        values,
    )


def rank_updates(
    states: NDArray[np.float64], changes: NDArray[np.float64], plan: GroupPlan, settings: EncodeSettings
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(N,) score of rows for pruning and (N,) whether any level carries them; arguments (T, 10 + C, N) in steps.

    `states` are differences to the canonical frame as decoded, `changes` to the original one. A row is static if it
    never changes by more than half a step, or if coding its states is expected to add more error than it mends.
    """
    withheld = partial(withheld_error, weights=plan.weights())
    moving = np.abs(changes).max(axis=(0, 1)) > 0.5
    if not settings.keep_all:
        variance = np.square(states).mean(axis=0, keepdims=True)
        coded = np.minimum(variance + LEAK * np.maximum(CODING_VARIANCE - variance, 0), CODING_VARIANCE)
        moving &= withheld(states) > withheld(np.sqrt(coded))
    if settings.update_rank == "error":
        return withheld(changes), moving
    if plan.moved is not None:
        return plan.moved, moving
    return plan.score * np.sqrt(np.einsum("tcn,tcn->n", changes, changes) / len(changes)), moving

"""The states of a package's top rung as numbers, to try other levels on. N rows of a group, n that move, T frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.sensitivity import measure_usage
from airgs_codec.coding.channels import Canonical, StateApplier
from airgs_codec.decoder.decode import decode_canonical
from airgs_codec.decoder.states import decode_pictures, state_units
from airgs_codec.package.layout import STATE
from airgs_codec.package.package import Package
from airgs_codec.package.region import CHECKING, DECIDING, Region, before_background, draw_views
from airgs_codec.package.tables import STATIC
from airgs_codec.render import Camera
from airgs_codec.render.backend import CPU, Renderer
from airgs_codec.scene.camera import training_views
from airgs_codec.scene.gaussians import Gaussians

MEASURED = ("sum", "max", "hits", "max x change")  # by which updates can be ranked here
SHARES = tuple(i / 10 for i in range(11))  # pruned, the paper's dense levels; 1: nothing is sent

TRAINING_DRAWS, CHECKING_DRAWS = 8, 4
MOST_MEASURED_VIEWS = 4


@dataclass(frozen=True, slots=True, eq=False)
class GroupStates:
    """Frames [start, stop) of a group at level 0 over the canonical space of the finest keys."""

    base: Canonical
    rows: NDArray[np.intp]  # (n,) that level 0 carries
    steps: NDArray[np.float64]  # (10 + C,) of the channels, at factor 1
    values: NDArray[np.float32]  # (T, 10 + C, n) differences to the canonical space
    level: StateApplier
    start: int

    def show(self, values: NDArray[np.float32]) -> Gaussians:
        """The frame that (10 + C, n) differences make; zeros where an update is withheld."""
        return self.level.apply(values)

    def without(self, frame: Gaussians, pruned: NDArray[np.bool_]) -> Gaussians:
        """A frame of this group without the (n,) pruned ones of the rows that move."""
        kept = np.ones(len(self.base.means), bool)
        kept[self.rows[pruned]] = False
        return frame.take(np.flatnonzero(kept))


def load_states(package: Package, group: int) -> GroupStates:
    """Decode a group. Segments with nothing to fetch are zeros. Raises FormatError."""
    m = package.manifest
    base = decode_canonical(package, group, 0)
    rows = np.flatnonzero(base.depths != STATIC)
    g = m.groups[group]
    steps = STATE.steps(g.state_steps, m.colour_channels)
    values = np.zeros((g.stop - g.start, len(steps), len(rows)), np.float32)
    for index, segment in zip(m.segments_of(group), g.segments, strict=True):
        if m.state_files(index, 0):
            units, frames = state_units(package, index, 0), range(segment.stop - segment.start)
            for t, shown in enumerate(decode_pictures(package, index, 0, frames), segment.start - g.start):
                values[t] = shown.values(slice(None), units)
    level = StateApplier.of(base, rows, g.state_steps, True, True)
    return GroupStates(base, rows, steps, values, level, g.start)


def score_rows(states: GroupStates, cameras: list[Camera], renderer: Renderer = CPU) -> dict[str, NDArray[np.float64]]:
    """(n,) for each of MEASURED: usage of the rows that move, seen by `cameras` in three frames of the group."""
    count = len(states.values)
    frames = [states.show(states.values[t]) for t in sorted({0, count // 2, count - 1})]
    usage = measure_usage(frames, cameras, renderer)
    changed = states.values / states.steps[:, None]
    size = np.sqrt(np.einsum("tcn,tcn->n", changed, changed) / count)
    scores = {name: usage.measure(name)[states.rows] for name in MEASURED[:3]}
    return scores | {MEASURED[3]: scores["max"] * size}


def kept_rows(score: NDArray[np.float64], pruned: float) -> NDArray[np.bool_]:
    """(n,) rows whose updates are sent when the `pruned` share with the lowest score is withheld, ties by row."""
    kept = np.zeros(len(score), bool)
    kept[np.argsort(-score, kind="stable")[: round((1 - pruned) * len(score))]] = True
    return kept


def checking_views(region: Region, cameras: list[Camera]) -> tuple[list[Camera], list[Camera]]:
    """Views to rank rows by and other views to measure with: of `cameras` if there are any, else drawn."""
    if cameras:
        seen = before_background(region, cameras)
        return training_views(seen), measured_views(seen)
    return draw_views(region, TRAINING_DRAWS, DECIDING), draw_views(region, CHECKING_DRAWS, CHECKING)


def measured_views(cameras: list[Camera]) -> list[Camera]:
    """The cameras that quality is measured on: held-out ones if there are any, else all.

    At most MOST_MEASURED_VIEWS of them, evenly spaced.
    """
    chosen = [c for c in cameras if c.held_out] or list(cameras)
    return [chosen[i] for i in evenly_spaced(len(chosen), MOST_MEASURED_VIEWS)]

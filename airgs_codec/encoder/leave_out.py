"""Planes and segments that a group's pictures can do without, by what rendering without them shows.

T frames and N rows of the group, n rows of its first level, C colour channels.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.importance import PICTURES, affordable, guess_channels, in_turn
from airgs_codec.coding.channels import Canonical, StateApplier, dequantise_key
from airgs_codec.encoder.plan import GroupPlan
from airgs_codec.media.metrics import mse
from airgs_codec.package import tables
from airgs_codec.package.layout import KEY, STATE
from airgs_codec.package.tables import STATIC, LeftOut
from airgs_codec.render import Camera, render
from airgs_codec.scene.gaussians import SH_REST, Gaussians
from airgs_codec.scene.sequence import GaussianSequence


def spare_key_planes(plan: GroupPlan, cameras: Sequence[Camera], price: float) -> NDArray[np.bool_]:
    """(7 + C,) channels that every row may take from the channel's median; noted in the plan.

    So are the Gaussians that are not written, with the bytes of as many of the written ones, keys alone.
    """
    channels, missing = len(plan.key_values), plan.count - len(plan.rows)
    if price == 0 and not missing:
        return np.zeros(channels, bool)
    steps = KEY.steps(plan.key_steps, channels - KEY.colour_start)[:, None]
    centres = np.median(plan.key_values, axis=1)
    sizes, guesses = guess_channels(plan.key_values[None] / steps, centres / steps[:, 0], plan.key_weights())
    sizes /= plan.stop - plan.start
    plan.leave_out("gaussians", missing, plan.removal_error, float(sizes.sum()) / len(plan.rows) * missing)
    if price == 0:
        return np.zeros(channels, bool)
    full = [(camera, render(g, camera).rgb) for g, camera in in_turn([_shown(plan, plan.key_values)], cameras)]

    def error(spare: NDArray[np.bool_]) -> float:
        shown = _shown(plan, np.where(spare[:, None], centres[:, None], plan.key_values))
        return float(np.mean([mse(render(shown, camera).rgb, picture) for camera, picture in full]))

    chosen, cost = affordable(sizes, guesses, error, price)
    plan.leave_out("key planes", int(chosen.sum()), cost, float(sizes[chosen].sum()))
    return chosen


def _shown(plan: GroupPlan, values: NDArray[np.float64]) -> Gaussians:
    transform = tables.unpack_matrix(plan.transform, len(values) - KEY.colour_start)
    depths = np.zeros(len(plan.codes), np.uint8)
    channels = values.astype(np.float32)
    return dequantise_key(
        channels, plan.codes, plan.classes, depths, transform, plan.grid, plan.key_steps
    ).to_gaussians()


def needed_bands(
    sequence: GaussianSequence, frame: int, span: int, cameras: Sequence[Camera], step: float, price: float
) -> tuple[int, list[LeftOut]]:
    """SH bands past DC that pictures of `frame`, coded once in `span` frames, need, and a note if that is not all.

    The highest goes as long as its bytes, at quantiser step `step`, are worth less than what rendering shows.
    """
    if not sequence.sh_degree or price == 0:
        return sequence.sh_degree, []
    g = sequence.load([frame]).frames[0]
    full = [(camera, render(g, camera).rgb) for g, camera in in_turn([g], cameras)]
    bands, cost, size = g.sh_degree, 0.0, 0.0
    while bands:
        fewer = g.with_degree(bands - 1)
        top = g.with_degree(bands).sh_rest[:, SH_REST[bands - 1] :]
        coefficients = top.reshape(1, len(g), -1).transpose(0, 2, 1).astype(np.float64) / step
        none = np.zeros(coefficients.shape[1])
        band = float(guess_channels(coefficients, none, np.zeros_like(coefficients[0]))[0].sum()) / span
        error = float(np.mean([mse(render(fewer, camera).rgb, picture) for camera, picture in full]))
        if error > price / 2 * (size + band):
            break
        bands, cost, size = bands - 1, error, size + band
    dropped = g.sh_degree - bands
    return bands, [LeftOut("sh bands", 0, dropped, float(f"{cost:.3g}"), float(f"{size:.3g}"))] if dropped else []


class StateNeeds:
    """What the states of a group are good for; `states` (T, 10 + C, N) in units, as `canonical.state_channels`."""

    def __init__(
        self, plan: GroupPlan, base: Canonical, states: NDArray[np.float64], cameras: Sequence[Camera], price: float
    ) -> None:
        """`plan` has its depths; `price` 0: everything is needed."""
        self._plan, self._base, self._cameras, self._price = plan, base, cameras, price
        rows = np.flatnonzero(plan.depths != STATIC)
        self._states = states[:, :, rows]
        self._steps = STATE.steps(plan.state_steps, base.colours.shape[1])[:, None]
        self._weights = plan.weights()[:, rows]
        self._level = StateApplier.of(base, rows, plan.state_steps, True, True)

    def spare_planes(self) -> NDArray[np.bool_]:
        """(10 + C,) channels that every row may take from the channel's median; noted in the plan."""
        count = self._states.shape[1]
        if self._price == 0 or not self._states.size:
            return np.zeros(count, bool)
        centres = np.median(self._states, axis=(0, 2))
        frames = len(self._states)
        sizes, guesses = guess_channels(self._states / self._steps, centres / self._steps[:, 0], self._weights)
        picked = evenly_spaced(frames, PICTURES)
        full = self._pictures(picked, np.zeros(count, bool), centres)

        def error(spare: NDArray[np.bool_]) -> float:
            return _difference(self._pictures(picked, spare, centres), full)

        chosen, cost = affordable(sizes / frames, guesses, error, self._price)
        self._plan.leave_out("state planes", int(chosen.sum()), cost, float(sizes[chosen].sum()) / frames)
        return chosen

    def spare_segments(self, spans: Sequence[tuple[int, int]]) -> NDArray[np.bool_]:
        """(S,) segments [start, stop), frames of the sequence, for which the canonical space may stand; noted."""
        frames, count = len(self._states), self._states.shape[1]
        if self._price == 0 or not self._states.size:
            return np.zeros(len(spans), bool)
        none = np.zeros(count)
        parts = [np.arange(start - self._plan.start, stop - self._plan.start) for start, stop in spans]
        pairs = [guess_channels(self._states[p] / self._steps, none, self._weights) for p in parts]
        sizes, guesses = (np.array([sum(pair[i]) for pair in pairs]) for i in (0, 1))
        shares = np.array([len(p) for p in parts]) / frames

        def error(spare: NDArray[np.bool_]) -> float:
            costs = []
            for part in (parts[i] for i in np.flatnonzero(spare)):
                picked = [int(part[i]) for i in evenly_spaced(len(part), PICTURES)]
                full = self._pictures(picked, np.zeros(count, bool), none)
                costs.append(_difference(self._pictures(picked, np.ones(count, bool), none), full) * len(part))
            return sum(costs) / frames

        chosen, cost = affordable(sizes / frames, guesses * shares, error, self._price)
        self._plan.leave_out("segments", int(chosen.sum()), cost, float(sizes[chosen].sum()) / frames)
        return chosen

    def _pictures(
        self, frames: Sequence[int], spare: NDArray[np.bool_], centres: NDArray[np.float64]
    ) -> list[NDArray[np.float32]]:
        shown = []
        for t in frames:
            values = np.where(spare[:, None], centres[:, None], self._states[t])
            shown.append(self._level.apply(values.astype(np.float32)))
        return [render(g, camera).rgb for g, camera in in_turn(shown, self._cameras)]


def _difference(a: Sequence[NDArray[np.float32]], b: Sequence[NDArray[np.float32]]) -> float:
    return float(np.mean([mse(x, y) for x, y in zip(a, b, strict=True)]))

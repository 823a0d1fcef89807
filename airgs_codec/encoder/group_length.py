"""How many frames should share a canonical space: what groups of different lengths cost, on a sample of the scene.

Keys get cheaper the longer a group is, states dearer: they grow with the distance from the canonical frame. N rows.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.grouping import count_runs
from airgs_codec.analysis.importance import mean_square_alpha
from airgs_codec.analysis.sensitivity import Sensitivity, measure_views
from airgs_codec.coding.grid import fit_grid, grid_codes
from airgs_codec.coding.motion import classify_motion
from airgs_codec.coding.weights import channel_weights
from airgs_codec.encoder.calibration.sample import CalibrationSample
from airgs_codec.encoder.calibration.subject import block_rows
from airgs_codec.encoder.plan import split_segments
from airgs_codec.encoder.rank import rank_updates
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.survey import GroupSpan, ShownPictures
from airgs_codec.encoder.views import ViewPlan
from airgs_codec.scene.camera import resized
from airgs_codec.scene.gaussians import Gaussians, mean_frame
from airgs_codec.scene.sequence import GaussianSequence

SHORTEST, LONGEST = 10, 240  # frames of a group
PARTS = (1, 2, 3, 5, 8, 12, 24)  # of equal length that a run of frames is split into, tried
PICTURES, PICTURE_PIXELS = 12, 60_000  # that tell which rows matter, and how large they are at most
SEGMENTS = 2  # of a group, evenly spaced, whose states are coded
SHARES = (0.0, 0.4, 0.75)  # of the updates withheld, tried
BLOCKS = 40  # of rows that are coded
LEAST_ERROR = 1e-12  # of pictures: below it nobody sees a difference
RATE_OF_ERROR = 0.4  # bytes fall with this power of the error that steps make, as single-rung packages show


@dataclass(frozen=True, slots=True)
class LengthCost:
    """What groups of one length cost at equal steps, estimated."""

    frames: int  # of a group
    bytes: float  # a frame
    error: float  # mean squared error of pictures

    @property
    def score(self) -> float:
        """Bytes a frame at equal error, but for a factor that all lengths share."""
        return self.bytes * max(self.error, LEAST_ERROR) ** RATE_OF_ERROR


def compare_lengths(sequence: GaussianSequence, views: ViewPlan, settings: EncodeSettings) -> list[LengthCost]:
    """The cost of each group length that was tried, best first; empty where there is nothing to choose.

    That is where keyframes are named, and in a scene shorter than two of the shortest groups. Lengths are tried about
    the middle of the longest run of frames with one number of rows.
    """
    if sequence.keyframes is not None:
        return []
    start, stop = max(count_runs(sequence), key=lambda run: run[1] - run[0])
    middle = (start + stop) // 2
    start, stop = max(start, middle - LONGEST // 2), min(stop, middle + LONGEST // 2)
    lengths = sorted({-(-(stop - start) // parts) for parts in PARTS if stop - start >= parts * SHORTEST})
    if len(lengths) < 2:
        return []
    trial = _Trial.of(sequence, (start, stop), lengths, views, settings)
    with ThreadPoolExecutor(settings.threads) as pool:
        return sorted(pool.map(trial.cost, lengths), key=lambda cost: cost.score)


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """Frames of a run, and what pictures say about their rows."""

    run: tuple[int, int]  # [start, stop)
    frames: Sequence[Gaussians]  # some of the sequence
    numbers: Sequence[int]  # of these frames in the sequence, ascending
    sensitivity: Sensitivity
    settings: EncodeSettings
    sequence: GaussianSequence
    trusted: bool

    @staticmethod
    def of(
        sequence: GaussianSequence,
        run: tuple[int, int],
        lengths: Sequence[int],
        views: ViewPlan,
        settings: EncodeSettings,
    ) -> _Trial:
        seen = [run[0] + i for i in evenly_spaced(run[1] - run[0], PICTURES)]
        windows = [_window(run, length) for length in lengths]
        coded = [n for window in windows for part in _segments(window, sequence, settings) for n in part]
        numbers = sorted({*seen, *coded})
        frames = sequence.load(numbers).frames
        share = min(1.0, (PICTURE_PIXELS / (views.deciding[0].width * views.deciding[0].height)) ** 0.5)
        cameras = [resized(camera, share) for camera in views.deciding]
        pictures = [(bisect_left(numbers, n), camera) for n, camera in zip(seen, cameras, strict=False)]
        _, sensitivity = measure_views(ShownPictures(frames, pictures), views.renderer)
        return _Trial(run, frames, numbers, sensitivity, settings, sequence, views.trusted)

    def cost(self, length: int) -> LengthCost:
        """What groups of so many frames cost."""
        window = _window(self.run, length)
        sample = self._sample(window)
        steps = self.settings.steps
        key_bytes, base = sample.code_key(steps, 1.0)
        transform = base.transform
        weights = channel_weights(sample.classes, sample.sensitivity, steps.state, transform)
        costs = []
        for part in _segments(window, self.sequence, self.settings):
            shown = [self.frames[bisect_left(self.numbers, n)].take(sample.index) for n in part]
            coded = replace(sample, frames=shown, segment_frames=len(shown))
            states = coded.states(base, steps)
            scores, moving = rank_updates(states[1:], states[1:] - states[0], weights)
            costs.append([coded.cost_without(states, steps, scores, moving, share) for share in SHARES])
        totals: list[list[float]] = np.mean(costs, axis=0).tolist()  # bytes and error for each share
        return min((LengthCost(length, key_bytes + b, e) for b, e in totals), key=lambda cost: cost.score)

    def _sample(self, window: GroupSpan) -> CalibrationSample:
        """Blocks of the rows that a group needs, in file order; `index` counts input rows."""
        inside = self.frames[bisect_left(self.numbers, window.start) : bisect_left(self.numbers, window.stop)]
        canonical, rows = mean_frame(inside), self._needed(inside)
        sensitivity, key = self.sensitivity.take(rows), canonical.take(rows)
        classes = classify_motion(sensitivity, key)
        order = np.argsort(grid_codes(key.means, classes, fit_grid(key.means, classes, self.settings.steps.grid)))
        index = order[block_rows(len(order), BLOCKS)]
        return CalibrationSample(
            index=rows[index],
            key=key.take(index),
            frames=[],
            classes=classes[index],
            sensitivity=sensitivity.take(index),
            moving=np.ones(len(index), bool),
            row_ratio=len(rows) / len(index),
            group_frames=window.frames,
            segment_frames=1,
        )

    def _needed(self, inside: Sequence[Gaussians]) -> NDArray[np.intp]:
        """Rows of some frames but those that together may be left out, by the first-order error of each."""
        errors = self.sensitivity.opacity * mean_square_alpha(inside)
        order = np.argsort(errors, kind="stable")
        allowed = self.settings.steps.rows**2 if self.trusted and not self.settings.keep_all else 0.0
        dropped = int(np.searchsorted(np.cumsum(errors[order]), allowed, side="right"))
        return np.sort(order[min(dropped, len(order) - 1) :]) if allowed else np.arange(len(order))


def _window(run: tuple[int, int], length: int) -> GroupSpan:
    """The group of so many frames about the middle of a run."""
    start = run[0] + (run[1] - run[0] - length) // 2
    return GroupSpan(0, start, start + length)


def _segments(window: GroupSpan, sequence: GaussianSequence, settings: EncodeSettings) -> list[range]:
    """Some segments of a group."""
    parts = split_segments(window, settings.segment_s, sequence.fps)
    return [range(*parts[i]) for i in evenly_spaced(len(parts), SEGMENTS)]

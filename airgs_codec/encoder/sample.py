"""A sample of the rows of one group, what coding it costs, and from that how many frames should share a group.

Keys get cheaper the longer a group is, states dearer: they grow with the distance from the canonical frame. T frames, N
rows of a group, n rows of the sample, c channels, C colour channels.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.grouping import count_runs
from airgs_codec.analysis.importance import mean_square_alpha
from airgs_codec.analysis.sensitivity import Sensitivity, measure_views
from airgs_codec.coding import escapes
from airgs_codec.coding.atlas import assemble, centre_codes, fit_atlas, picture_size, read_codes
from airgs_codec.coding.channels import Canonical, colour_transform, dequantise_key, key_channels, state_channels
from airgs_codec.coding.grid import fit_grid, grid_codes
from airgs_codec.coding.motion import channel_weights, classify_motion, withheld_error
from airgs_codec.coding.quantize import StepSettings, from_codes, to_codes
from airgs_codec.coding.rangecoder import encode_columns
from airgs_codec.coding.sidecar import KeySidecar, pack_key_sidecar
from airgs_codec.encoder.plan import assign_depths, rank_updates, split_segments
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.survey import GroupSpan, ShownPictures, ViewPlan
from airgs_codec.media.h264 import (
    ClosedGop,
    CodecSettings,
    encode_gop,
    key_codec,
    qp_step,
    state_codec,
)
from airgs_codec.package.layout import KEY, STATE
from airgs_codec.package.tables import KeySteps, unpack_matrix
from airgs_codec.scene.camera import resized
from airgs_codec.scene.gaussians import Gaussians, mean_frame
from airgs_codec.scene.sequence import GaussianSequence

BLOCK_ROWS = 256  # a block of an atlas
PRESET = "fast"  # of x264, for trial encodes

SHORTEST, LONGEST = 10, 240  # frames of a group
PARTS = (1, 2, 3, 5, 8, 12, 24)  # of equal length that a run of frames is split into, tried
PICTURES, PICTURE_PIXELS = 12, 60_000  # that tell which rows matter, and how large they are at most
WORSE = 2  # lengths in turn that cost more than a longer one, after which shorter ones are not tried
SEGMENTS = 2  # of a group, evenly spaced, whose states are coded
WAYS = ((0.0, 1.0), (0.4, 1.0), (0.0, 2.0), (0.4, 2.0))  # shares of the updates withheld, factors on steps, tried
BLOCKS = 40  # of rows that are coded
LEAST_ERROR = 1e-12  # of pictures: below it nobody sees a difference
RATE_OF_ERROR = 0.4  # bytes fall with this power of the error that steps make, as single-rung packages show


@dataclass(frozen=True, slots=True)
class Cost:
    """Bytes a frame of the group, and mean squared error over picture samples."""

    bytes: float
    key_error: float  # of rows that show the canonical frame
    state_error: float  # of rows that are updated


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationSample:
    """Blocks of rows of a group in file order, over some of its frames."""

    index: NDArray[np.intp]  # (n,) rows of the group in file order
    key: Gaussians  # n rows of the canonical frame
    frames: list[Gaussians]  # T, one after the other
    classes: NDArray[np.int16]  # (n,)
    sensitivity: Sensitivity  # (n,)
    moving: NDArray[np.bool_]  # (n,) rows that some level carries
    factors: NDArray[np.float64]  # (n,) on the key steps
    row_ratio: float  # rows of the group for each of the sample
    group_frames: int  # frames of the group
    segment_frames: int  # frames of a state segment

    def take(self, rows: NDArray[np.bool_]) -> CalibrationSample:
        """Fewer rows, as a sample of a group that has fewer by the same share."""
        return replace(
            self,
            index=self.index[rows],
            key=self.key.take(rows),
            frames=[frame.take(rows) for frame in self.frames],
            classes=self.classes[rows],
            sensitivity=self.sensitivity.take(np.flatnonzero(rows)),
            moving=self.moving[rows],
            factors=self.factors[rows],
        )

    def cost(self, steps: StepSettings, attributes: Sequence[str] = STATE.attributes) -> Cost:
        """Estimate what coding the keys and states of these attributes costs at `steps`."""
        size, errors = 0.0, np.zeros(len(self.classes))
        for attribute in attributes:
            key_bytes, base = self.code_key(steps, 1.0, (attribute,))
            states = self.states(base, steps)
            state_bytes, shown = self.code_states(states, 1.0, STATE.slice(attribute))
            size += key_bytes + state_bytes
            errors += self.error(shown, steps)
        return Cost(size, float(errors[~self.moving].sum()), float(errors[self.moving].sum()))

    def code_key(
        self, steps: StepSettings, factor: float, attributes: Sequence[str] = STATE.attributes
    ) -> tuple[float, Canonical]:
        """Bytes a frame, and the canonical space as decoded; attributes that are not named stay exact."""
        transform = self._transform(steps.key)
        channels, size = self._code_key_channels(steps.key, transform, factor, attributes)
        grid = fit_grid(self.key.means, self.classes, steps.grid)
        codes = grid_codes(self.key.means, self.classes, grid)
        still = np.zeros(len(codes), np.uint8)
        if "means" in attributes:
            order = np.argsort(codes, kind="stable")
            size += len(pack_key_sidecar(KeySidecar(codes[order], self.classes[order], still), grid))
        base = dequantise_key(channels, KeySidecar(codes, self.classes, still), transform, grid, steps.key)
        return self.row_ratio * size / self.group_frames, base

    def _code_key_channels(
        self, steps: KeySteps, transform: NDArray[np.float64], factor: float, attributes: Sequence[str]
    ) -> tuple[NDArray[np.float32], float]:
        """(7 + C, n) key channels, those of the named attributes as decoded, and the bytes of their picture."""
        values = key_channels(self.key, transform, steps)
        channels = values.astype(np.float32)
        chosen = np.zeros(len(values), bool)
        for attribute in set(attributes) & set(KEY.attributes):
            chosen[KEY.slice(attribute)] = True
        if not chosen.any():
            return channels, 0.0
        step = KEY.steps(steps, len(transform))[chosen] * factor
        centres = np.median(values[chosen], axis=1, keepdims=True)
        apart = (values[chosen] - centres) / self.factors
        sizes, decoded = encode_and_decode(apart[None], step, key_codec(PRESET))
        channels[chosen] = centres + decoded[0] * self.factors
        return channels, float(sizes[0])

    def error(self, errors: NDArray[np.float64], steps: StepSettings) -> NDArray[np.float64]:
        """(n,) what errors (T, 10 + C, n), in steps, add to the mean squared error of pictures of the whole group."""
        weights = channel_weights(
            self.classes, self.sensitivity.by_attribute(), steps.state, self._transform(steps.key)
        )
        return self.row_ratio * withheld_error(errors, weights)

    def _transform(self, steps: KeySteps) -> NDArray[np.float64]:
        return unpack_matrix(colour_transform(self.key, steps), 3 * (1 + self.key.sh_rest.shape[1]))

    def states(self, base: Canonical, steps: StepSettings) -> NDArray[np.float64]:
        """(1 + T, 10 + C, n) differences of the canonical frame and the others to a canonical space, in steps."""
        values = state_channels([self.key, *self.frames], base, steps.state)
        return values / STATE.steps(steps.state, base.colours.shape[1])[:, None]

    def cost_of(
        self,
        states: NDArray[np.float64],
        steps: StepSettings,
        scores: NDArray[np.float64],
        moving: NDArray[np.bool_],
        way: tuple[float, float],
    ) -> tuple[float, float]:
        """Bytes a frame and error of pictures of one of WAYS; the updates of the least `scores` are withheld.

        `states` are those of `self.states`.
        """
        sent = assign_depths(scores, moving, [way[0]]) == 0
        size, coded = replace(self, moving=sent).code_states(states, way[1])
        return size, float(self.error(np.where(sent, coded, states[1:]), steps).sum())

    def code_states(
        self, states: NDArray[np.float64], factor: float, part: slice = slice(None)
    ) -> tuple[float, NDArray[np.float64]]:
        """Bytes a frame of moving rows, and (T, 10 + C, n) errors in steps of what is shown, in the channels `part`.

        `states` are those of `self.states`. A row that is not moving has the error of its canonical frame.
        """
        errors = np.zeros_like(states[1:])
        channels = np.arange(states.shape[1])[part]
        still, moving = np.flatnonzero(~self.moving), np.flatnonzero(self.moving)
        errors[:, channels[:, None], still] = states[0][channels[:, None], still]
        if not len(moving):
            return 0.0, errors
        values = states[1:, channels[:, None], moving]
        sizes, decoded = encode_and_decode(values, np.full(len(channels), factor), state_codec(PRESET))
        errors[:, channels[:, None], moving] = decoded - values
        others = float(np.mean(sizes[1:])) if len(sizes) > 1 else 0.0
        return self.row_ratio * (sizes[0] + (self.segment_frames - 1) * others) / self.segment_frames, errors


def block_rows(rows: int, most: int) -> NDArray[np.intp]:
    """(n,) rows of at most `most` evenly spaced blocks of BLOCK_ROWS."""
    blocks = np.array(evenly_spaced(-(-rows // BLOCK_ROWS), most))
    index = (blocks[:, None] * BLOCK_ROWS + np.arange(BLOCK_ROWS)).ravel()
    return index[index < rows]


@dataclass(frozen=True, slots=True)
class LengthCost:
    """The estimated cost of groups of one length at equal steps."""

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
    the middle of the longest run of frames with one number of rows, from the longest on, until WORSE in turn cost more.
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
    costs: list[LengthCost] = []
    with ThreadPoolExecutor(settings.threads) as pool:
        for length in reversed(lengths):
            costs.append(trial.cost(length, pool))
            if min(cost.score for cost in costs) < min(cost.score for cost in costs[-WORSE:]):
                break
    return sorted(costs, key=lambda cost: cost.score)


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

    def cost(self, length: int, pool: ThreadPoolExecutor) -> LengthCost:
        """Estimate the cost of groups of so many frames, with trial encodes on the threads of a pool."""
        window = _window(self.run, length)
        sample = self._sample(window)
        steps = self.settings.steps
        key_bytes, base = sample.code_key(steps, 1.0)
        transform = base.transform
        weights = channel_weights(sample.classes, sample.sensitivity.by_attribute(), steps.state, transform)
        costs = []
        for part in _segments(window, self.sequence, self.settings):
            shown = [self.frames[bisect_left(self.numbers, n)].take(sample.index) for n in part]
            coded = replace(sample, frames=shown, segment_frames=len(shown))
            states = coded.states(base, steps)
            scores, moving = rank_updates(states[1:], states[1:] - states[0], weights)
            trials = [pool.submit(coded.cost_of, states, steps, scores, moving, way) for way in WAYS]
            costs.append([trial.result() for trial in trials])
        totals: list[list[float]] = np.mean(costs, axis=0).tolist()  # bytes and error of each way
        return min((LengthCost(length, key_bytes + b, e) for b, e in totals), key=lambda cost: cost.score)

    def _sample(self, window: GroupSpan) -> CalibrationSample:
        """Blocks of the rows that a group needs, in file order; `index` counts input rows."""
        inside = self.frames[bisect_left(self.numbers, window.start) : bisect_left(self.numbers, window.stop)]
        canonical, rows = mean_frame(inside), self._needed(inside)
        sensitivity, key = self.sensitivity.take(rows), canonical.take(rows)
        classes = classify_motion(sensitivity.means, key)
        order = np.argsort(grid_codes(key.means, classes, fit_grid(key.means, classes, self.settings.steps.grid)))
        index = order[block_rows(len(order), BLOCKS)]
        return CalibrationSample(
            index=rows[index],
            key=key.take(index),
            frames=[],
            classes=classes[index],
            sensitivity=sensitivity.take(index),
            moving=np.ones(len(index), bool),
            factors=np.ones(len(index)),
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


def encode_and_decode(
    values: NDArray[np.float64], steps: NDArray[np.float64], codec: CodecSettings
) -> tuple[list[int], NDArray[np.float64]]:
    """Code values as one atlas, as a trial, and decode them again.

    (T, C, N) values, (C,) steps -> bytes of each of T pictures, escapes in the first, and the decoded (T, C, N).
    """
    gain = qp_step(codec.qp)
    codes = to_codes(values, steps, gain)
    atlas = fit_atlas(codes, gain / 2)
    if not atlas.planes:
        centres = np.array(atlas.centres, np.int32)[:, None]
        return [0] * len(codes), np.broadcast_to(from_codes(centres, steps, gain), values.shape).astype(np.float64)
    luma, bases = escapes.split(centre_codes(codes, atlas))
    size = picture_size(atlas)
    coded = encode_gop(ClosedGop(assemble(luma, atlas, *size), 0, 1), size, Fraction(30), codec)
    sizes = list(coded.picture_bytes)
    sizes[0] += len(encode_columns(escapes.Escapes.of(bases).columns()))
    pictures = coded.pictures("a trial")
    decoded = [from_codes(read_codes(p, atlas, b), steps, gain) for p, b in zip(pictures, bases, strict=True)]
    return sizes, np.stack(decoded).astype(np.float64)

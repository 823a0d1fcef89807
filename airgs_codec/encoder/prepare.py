"""From a sequence as it is given to one that is ready to be encoded: frames named, rows in order, groups split."""

from __future__ import annotations

import os
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec._sampling import evenly_spaced
from airgs_codec._settings import available_cores
from airgs_codec.analysis.grouping import Grouping, count_runs, plan_groups
from airgs_codec.analysis.importance import mean_square_alpha
from airgs_codec.analysis.rows import IN_ORDER, Restored, compare_order, restore_rows
from airgs_codec.analysis.sensitivity import Sensitivity, measure_views
from airgs_codec.coding.channels import Canonical
from airgs_codec.coding.grid import fit_grid, grid_codes
from airgs_codec.coding.motion import channel_weights, classify_motion
from airgs_codec.coding.quantize import scale_steps
from airgs_codec.encoder.calibrate import balance, measure_step_slopes
from airgs_codec.encoder.pipeline import MORE, WORTH, PreparedSequence, Read, Step, chosen, seen
from airgs_codec.encoder.plan import MOTION_FRAMES, rank_updates, split_segments
from airgs_codec.encoder.sample import CalibrationSample, at_equal_error, block_rows
from airgs_codec.encoder.settings import KEPT, EncodeSettings
from airgs_codec.encoder.survey import GroupSpan, ShownPictures, ViewPlan, plan_views
from airgs_codec.jobs.engines import InProcess
from airgs_codec.jobs.job import digest
from airgs_codec.jobs.work import Work
from airgs_codec.scene.camera import resized
from airgs_codec.scene.frames import HeldFrames, turn_least
from airgs_codec.scene.gaussians import Gaussians, mean_frame
from airgs_codec.scene.sequence import GaussianSequence

SHORTEST, LONGEST = 10, 240  # frames of a group
PARTS = (1, 2, 3, 5, 8, 12, 24)  # of equal length that a run of frames is split into, tried
PICTURES, PICTURE_PIXELS = 12, 60_000  # that tell which rows matter, and how large they are at most
WORSE = 2  # lengths in turn that cost more than a longer one, after which shorter ones are not tried
SEGMENTS = 2  # of a group, evenly spaced, whose states are coded
WITHHELD = (0.0, 0.4)  # shares of the updates, tried
BLOCKS, FEWER_BLOCKS = 40, 12  # of rows that are coded, and of those that tell steps
TOGETHER = 100  # times the errors of single rows is about what many that are left out make: they all darken pictures
TABLE = 1500  # bytes that the table of a group takes, about
CHUNK = 16  # frames that are looked at by one call
HELD_SHARE = 8  # one byte in so many of the memory may hold frames: the arrays of a group take several times its own


@dataclass(frozen=True, slots=True)
class Ordered:
    """A sequence whose frames are named and whose rows are in order."""

    names: tuple[str, ...]  # SHA-256 of each frame as it is read
    rows: Restored


def hold_frames(sequence: GaussianSequence) -> GaussianSequence:
    """The sequence with memory for frames that are read, until it is closed; processes read on their own.

    Each is read once where it has room for all of them, else three times: to name it, while its group is surveyed and
    while it is encoded.
    """
    return sequence if sequence.held is not None else replace(sequence, held=HeldFrames(held_bytes()))


def held_bytes() -> int:
    """Bytes of frames that may be held: 1 of HELD_SHARE of the machine's, or 1 GiB where it does not say."""
    if not hasattr(os, "sysconf"):
        return 1 << 30
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // HELD_SHARE


def order_rows(sequence: GaussianSequence, settings: EncodeSettings, work: Work) -> Ordered:
    """Look at all frames, name them and put their rows into order. Raises SceneError for a broken one."""
    names, in_order = look_at_frames(sequence, work)
    return Ordered(names, restore_rows(sequence, settings.rows, work.progress, in_order=in_order))


def prepare(
    ordered: Ordered, settings: EncodeSettings, work: Work, attribution: str | None, views: ViewPlan | None = None
) -> PreparedSequence:
    """Choose the views of a sequence and split it into groups of the length that is asked for, or that costs least.

    `attribution`: who made the scene, by default what the sequence says. `views`: those that are chosen already.
    """
    sequence = ordered.rows.sequence
    views = views or plan_views(sequence, settings)
    grouping = _plan_groups(sequence, ordered.names, views, settings, work)
    notes = (*sequence.notes, *ordered.rows.notes, *grouping.notes)
    credit = sequence.attribution if attribution is None else attribution
    together = held_bytes() if isinstance(work.engine, InProcess) else None  # processes read on their own
    return PreparedSequence(sequence, ordered.names, grouping.spans, views, notes, credit, together)


def look_at_frames(sequence: GaussianSequence, work: Work) -> tuple[tuple[str, ...], bool]:
    """Name all frames of a sequence, and say whether rows of each are those of the frame before it.

    Raises SceneError for a broken frame.
    """
    starts = [start for start, _ in count_runs(sequence)]
    bounds = [(at, min(at + CHUNK, len(sequence))) for at in range(0, len(sequence), CHUNK)]
    looked = work.map("frames", look, [(sequence, *bound, starts) for bound in bounds])
    return tuple(name for names, _ in looked for name in names), all(in_order for _, in_order in looked)


def look(sequence: GaussianSequence, start: int, stop: int, starts: Sequence[int]) -> tuple[list[str], bool]:
    """Look at frames [start, stop); those that `starts` names begin runs, whose rows are not those before."""
    before = sequence.read(start - 1) if start and start not in starts else None
    names, in_order = [], True
    for number in range(start, stop):
        frame = sequence.read(number)
        names.append(digest(frame))
        if before is not None and number not in starts and in_order:
            in_order = compare_order(before, frame)[0] == IN_ORDER
        before = frame
    return names, in_order


@dataclass(frozen=True, slots=True)
class LengthCost:
    """The estimated cost of groups of one length at equal steps."""

    frames: int  # of a group
    bytes: float  # a frame
    error: float  # mean squared error of pictures

    @property
    def score(self) -> float:
        """Bytes a frame at equal error, but for a factor that all lengths share."""
        return at_equal_error(self.bytes, self.error)


def compare_lengths(sequence: GaussianSequence, views: ViewPlan, settings: EncodeSettings) -> list[LengthCost]:
    """The cost of each group length that was tried, best first; empty where there is nothing to choose.

    That is where keyframes are named, and in a scene shorter than two of the shortest groups. Lengths are tried
    in the middle of the longest run of frames with one number of rows, from the longest on, until WORSE in turn cost
    more; all groups of the run but one differ from that as one in its middle differs from one at its start.
    """
    if sequence.keyframes is not None:
        return []
    whole = start, stop = max(count_runs(sequence), key=lambda run: run[1] - run[0])
    middle = (start + stop) // 2
    start, stop = max(start, middle - LONGEST // 2), min(stop, middle + LONGEST // 2)
    lengths = sorted({-(-(stop - start) // parts) for parts in PARTS if stop - start >= parts * SHORTEST})
    if len(lengths) < 2:
        return []
    trial = _Trial.of(sequence, (start, stop), lengths, views, settings)
    if settings.calibrate != "none":
        trial = trial.balanced(lengths[-1])
    costs: list[LengthCost] = []
    with ThreadPoolExecutor(settings.threads) as pool:
        for length in reversed(lengths):
            costs.append(trial.cost(length, -(-(whole[1] - whole[0]) // length), pool))
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
        others = [run[0] + i for length in lengths for i in evenly_spaced(length, MOTION_FRAMES)]
        numbers = sorted({*seen, *coded, *others})
        frames = turn_least(sequence.load(numbers)).frames
        share = min(1.0, (PICTURE_PIXELS / (views.deciding[0].width * views.deciding[0].height)) ** 0.5)
        cameras = [resized(camera, share) for camera in views.deciding]
        pictures = [(bisect_left(numbers, n), camera) for n, camera in zip(seen, cameras, strict=False)]
        _, sensitivity = measure_views(ShownPictures(frames, pictures), views.renderer)
        return _Trial(run, frames, numbers, sensitivity, settings, sequence, views.trusted)

    def balanced(self, length: int) -> _Trial:
        """The trial at the steps that groups of so many frames ask for, by fewer rows."""
        steps, threads = self.settings.steps, self.settings.threads
        window = _window(self.run, length)
        sample = self._sample(window, FEWER_BLOCKS, self._needed(self._inside(window)))
        base = sample.code_key(steps, 1.0)[1]
        coded = next(self._segments(sample, length, base))[0]
        settings = replace(
            self.settings, steps=scale_steps(steps, balance(measure_step_slopes(coded, steps, threads))[0])
        )
        return replace(self, settings=settings)

    def cost(self, length: int, groups: int, pool: ThreadPoolExecutor) -> LengthCost:
        """Estimate the cost of so many groups of so many frames, with trial encodes on the threads of a pool."""
        steps, window = self.settings.steps, _window(self.run, length)
        other = self._inside(GroupSpan(0, self.run[0], self.run[0] + length))
        rows = self._needed(self._inside(window))
        joined = np.union1d(rows, self._needed(other))
        apart = groups > 1 and window.start > self.run[0]  # or else there is none to differ from
        differ = apart and self.settings.keys == KEPT and len(joined) <= (1 + MORE) * len(rows)
        sample = self._sample(window, BLOCKS, joined if differ else rows)
        key_bytes, base = sample.code_key(steps, 1.0)
        if differ:
            size = sample.code_difference(steps, base, mean_frame(other).take(sample.index)) / length
            size = size if size <= (1 - WORTH) * key_bytes else key_bytes
            key_bytes = (key_bytes + (groups - 1) * size) / groups
        costs = []
        for coded, states, scores in self._segments(sample, length, base):
            trials = [pool.submit(coded.cost_of, states, steps, scores, share) for share in WITHHELD]
            costs.append([trial.result() for trial in trials])
        totals: list[list[float]] = np.mean(costs, axis=0).tolist()  # bytes and error of each share
        return min(
            (LengthCost(length, key_bytes + TABLE / length + b, e) for b, e in totals), key=lambda cost: cost.score
        )

    def _segments(
        self, sample: CalibrationSample, length: int, base: Canonical
    ) -> Iterator[tuple[CalibrationSample, NDArray[np.float64], NDArray[np.float64]]]:
        """A sample of a group in some of its segments, with its states over `base` and the scores of its updates."""
        steps = self.settings.steps
        weights = channel_weights(sample.classes, sample.sensitivity.by_attribute(), steps.state, base.transform)
        for part in _segments(_window(self.run, length), self.sequence, self.settings):
            shown = [self.frames[bisect_left(self.numbers, n)].take(sample.index) for n in part]
            coded = replace(sample, frames=shown, segment_frames=len(shown))
            states = coded.states(base, steps)
            scores, moving = rank_updates(states[1:], states[1:] - states[0], weights)
            yield replace(coded, moving=moving).with_line(states, steps, FEWER_BLOCKS), states, scores

    def _sample(self, window: GroupSpan, blocks: int, rows: NDArray[np.intp]) -> CalibrationSample:
        """Blocks of the rows of a group, in file order; `index` counts input rows."""
        canonical = mean_frame(self._inside(window))
        sensitivity, key = self.sensitivity.take(rows), canonical.take(rows)
        classes = classify_motion(sensitivity.means, key)
        order = np.argsort(grid_codes(key.means, classes, fit_grid(key.means, classes, self.settings.steps.grid)))
        index = order[block_rows(len(order), blocks)]
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

    def _inside(self, window: GroupSpan) -> Sequence[Gaussians]:
        """Frames of a group."""
        return self.frames[bisect_left(self.numbers, window.start) : bisect_left(self.numbers, window.stop)]

    def _needed(self, inside: Sequence[Gaussians]) -> NDArray[np.intp]:
        """Rows of some frames but those that may be left out, by TOGETHER times the first-order error of each."""
        errors = self.sensitivity.opacity * mean_square_alpha(inside)
        order = np.argsort(errors, kind="stable")
        allowed = self.settings.steps.rows**2 / TOGETHER if self.trusted and not self.settings.keep_all else 0.0
        dropped = int(np.searchsorted(np.cumsum(errors[order]), allowed, side="right"))
        return np.sort(order[min(dropped, len(order) - 1) :]) if allowed else np.arange(len(order))


def _window(run: tuple[int, int], length: int) -> GroupSpan:
    """A group of so many frames from the middle of a run on, or as near to it as there is room."""
    start = min((run[0] + run[1]) // 2, run[1] - length)
    return GroupSpan(0, start, start + length)


def _segments(window: GroupSpan, sequence: GaussianSequence, settings: EncodeSettings) -> list[range]:
    """Some segments of a group."""
    parts = split_segments(window, settings.segment_s, sequence.fps)
    return [range(*parts[i]) for i in evenly_spaced(len(parts), SEGMENTS)]


LENGTHS = Step("lengths of groups", compare_lengths, ("sequence", "views", "settings"), "lengths")


def _plan_groups(
    sequence: GaussianSequence, names: Sequence[str], views: ViewPlan, settings: EncodeSettings, work: Work
) -> Grouping:
    """Groups of the length that is asked for, or that costs least."""
    if settings.group_frames is not None:
        return plan_groups(sequence, settings.group_frames)
    orders = [sequence.orders.get(frame) for frame in range(len(sequence))]
    content = (names, orders, sequence.breaks, sequence.keyframes, sequence.sh_degree, sequence.fps)
    alone = chosen(replace(settings, threads=available_cores()))
    known = {"sequence": Read(sequence, content), "views": Read(views, seen(views)), "settings": alone}
    costs = work.result(LENGTHS.job("", known))
    if not costs:
        return plan_groups(sequence)
    grouping = plan_groups(sequence, costs[0].frames)
    ranked = ", ".join(f"{cost.frames}: {cost.score / costs[0].score - 1:+.0%}" for cost in costs[1:])
    story = (
        f"groups of {costs[0].frames} frames, the cheapest on a sample (others at equal quality, in bytes: {ranked})"
    )
    return replace(grouping, notes=[story, *grouping.notes])

"""Parts that a scene does not need, chosen by the error of pictures rendered without them. N Gaussians."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from airgs_codec.analysis.sensitivity import CODING_VARIANCE, Sensitivity
from airgs_codec.media.metrics import mse
from airgs_codec.render import Camera, Without
from airgs_codec.render.backend import CPU, Renderer
from airgs_codec.scene.beside import Usage
from airgs_codec.scene.gaussians import Gaussians

Values = NDArray[np.float64]
Mask = NDArray[np.bool_]
Still = tuple[Gaussians, Camera]
PRECISION = 0.01  # of the rows
OVERLAP = 20.0  # times the errors of single rows, about, is that of all together: they hide each other
CLOSE = 0.85  # of the squared error that is allowed: enough rows are left out
DETAIL = 37  # times the error that is allowed: where a picture without rows differs by more, it shows something else
WIDEST_CHANGE = 255  # steps: larger values count as this one when entropy is estimated


def removal_errors(frames: Sequence[Gaussians], s: Sensitivity) -> NDArray[np.float64]:
    """Return (N,) the mean squared error of pictures without one row.

    A picture is linear in each alpha, so that alpha^2 times the squared derivative is exactly that.
    """
    squares = np.zeros(len(frames[0]))
    for g in frames:
        squares += g.opacities().astype(np.float64) ** 2
    return s.opacity * (squares / len(frames))


def importance(errors: Values, usage: Usage) -> NDArray[np.float64]:
    """Return (N,) how much pictures need each row, by its `removal_errors`; 0: it is in no picture.

    Only the order of the values is meaningful. Rows that replace each other look cheap one by one; the factors of their
    blending weights (max and sum) correct that.
    """
    return usage.peak * usage.total * errors


def pooled_error(errors: Sequence[float]) -> float:
    """Return the root mean square of mean squared errors of pictures: a mean in which the worst ones weigh more."""
    return float(np.sqrt(np.mean(np.square(errors))))


def pooled_within(errors: Iterable[float], count: int, most: float) -> float:
    """Return `pooled_error` of `count` errors, or infinity as soon as it is sure to be beyond `most`."""
    total = 0.0
    for error in errors:
        total += error**2
        if total > count * most**2:
            return math.inf
    return math.sqrt(total / count)


@dataclass(frozen=True, slots=True, eq=False)
class WrittenRows:
    """Rows that are written, and what leaving the others out costs."""

    rows: NDArray[np.intp]  # ascending
    error: float  # pooled error of pictures without the others

    @staticmethod
    def all(count: int) -> WrittenRows:
        """Return all of `count` rows, at no error."""
        return WrittenRows(np.arange(count), 0.0)


class RowPruning:
    """Leaves out the least important rows of some frames."""

    def __init__(
        self,
        pictures: Iterable[Still],
        rank: Values,
        expected: Values,
        errors: dict[int, float],
        renderer: Renderer = CPU,
    ) -> None:
        """`rank` is the (N,) `importance` of the rows, `expected` are their (N,) `removal_errors`.

        `errors` holds what has been rendered: rows left out -> error. Callers pass the same dictionary, at first an
        empty one, for the same pictures.
        """
        self._pictures, self._renderer, self._order = pictures, renderer, np.argsort(rank, kind="stable")
        self._expected = np.cumsum(expected[self._order])  # of leaving out so many, if they did not hide each other
        self._errors = errors
        self._errors[0] = 0.0
        self._unused = min(int(np.count_nonzero(rank == 0)), len(rank) - 1)
        self._last: tuple[int, Sequence[NDArray[np.float32]]] = (-1, ())  # rows left out last, and pictures without

    @cached_property
    def _seen(self) -> list[tuple[Without, NDArray[np.float32]]]:
        drawn = [self._renderer.load(g).without(camera) for g, camera in self._pictures]
        return [(without, without(None)) for without in drawn]

    def within(self, allowed: float) -> WrittenRows:
        """Choose the rows to write so that leaving out the others changes pictures by at most `allowed` (RMS, 0..1).

        Their number is found to PRECISION of the rows that are seen, or to CLOSE of the allowed squared error, starting
        with the rows of importance 0 and with all but one. What was rendered before only saves time.
        """
        most, least = allowed**2, max(1, math.ceil(PRECISION * (len(self._order) - self._unused)))
        rows = len(self._order)
        known = {0: 0.0} | {count: self.error_of(rows - count) for count in (self._unused, rows - 1)}
        for guesses in itertools.count():
            low = max(count for count, error in known.items() if error <= most)
            high = min((count for count in known if count > low), default=low)
            if high - low <= least or known[low] >= CLOSE * most > 0:
                break
            count, near = (low + high) // 2, min(least, (high - low) // 2)
            if guesses < 6 and most > 0:
                guess = self._guess(known, count, (1 + CLOSE) / 2 * most)
                guess = rows - least * round((rows - guess) / least)  # as many written ones whatever nobody sees
                count = guess if low + near <= guess <= high - near else count
            known[count] = self.error_of(rows - count)
        return WrittenRows(np.sort(self._order[low:]), known[low])

    def _guess(self, errors: Mapping[int, float], middle: int, error: float) -> int:
        """Return the count of an error, by the expected ones as the two nearest known errors correct them, or `middle`.

        In logarithms; OVERLAP times the expected errors where none is known, and in proportion where one is.
        """
        known = [
            (math.log(self._expected[count - 1]), math.log(found / error))
            for count, found in errors.items()
            if found > 0 and self._expected[count - 1] > 0 and count < len(self._order) - 1  # tells nothing of fewer
        ]
        (x, y), *others = sorted(known, key=lambda one: abs(one[1]))[:2] or [(math.log(error / OVERLAP), 0.0)]
        slope = (others[0][1] - y) / (others[0][0] - x) if others and others[0][0] != x else 1.0
        if slope <= 0:
            return middle
        most = math.log(self._expected[-1]) if self._expected[-1] > 0 else 0.0
        return 1 + int(np.searchsorted(self._expected, math.exp(min(x - y / slope, most))))

    def with_details(self, written: WrittenRows, allowed: float) -> WrittenRows:
        """Add those of the rows left out `within` an error that matter where pictures without them are plainly wrong.

        A mean over pictures ignores small things that people look at, such as eyes.
        """
        mask = np.zeros(len(self._order), bool)
        mask[written.rows] = True
        count, pictures = self._last
        if count != len(mask) - len(written.rows):
            pictures = self._draw(mask)
        for _ in range(5):
            missing = ~mask & (self._pixels_given(pictures, allowed) > 0.05)
            if not missing.any():
                break
            mask |= missing
            pictures = self._draw(mask)
        return WrittenRows(np.flatnonzero(mask), self._error_in(pictures))

    def _pixels_given(self, pictures: Sequence[NDArray[np.float32]], allowed: float) -> NDArray[np.float64]:
        """Return (N,) pixels that each row gives to places where pictures without some rows are plainly wrong."""
        given = np.zeros(len(self._order))
        for (g, camera), shown, (_, full) in zip(self._pictures, pictures, self._seen, strict=True):
            mask = np.abs(shown - full).max(axis=-1) > DETAIL * allowed
            if mask.any():
                w = self._renderer.load(g).weights(camera, mask)
                given += np.bincount(w.ids, w.inside, len(given))
        return given

    def error_of(self, written: int) -> float:
        """Return the pooled error of pictures of only the `written` most important rows."""
        left_out = len(self._order) - written
        if left_out not in self._errors:
            mask = np.ones(len(self._order), bool)
            mask[self._order[:left_out]] = False
            self._last = left_out, self._draw(mask)
            self._errors[left_out] = self._error_in(self._last[1])
        return self._errors[left_out]

    def _error_in(self, pictures: Sequence[NDArray[np.float32]]) -> float:
        return pooled_error([mse(shown, full) for shown, (_, full) in zip(pictures, self._seen, strict=True)])

    def _draw(self, written: NDArray[np.bool_]) -> list[NDArray[np.float32]]:
        return [without(written) for without, _ in self._seen]


def select_omissions(
    sizes: Values, guesses: Values, error: Callable[[Mask, float], float], price: float
) -> tuple[Mask, float]:
    """Choose which of (c,) things to leave out, as a mask, and return the mean squared error that this makes.

    `sizes` are bytes a frame; `guesses`, estimates of the error of leaving each one out, only rank the things; `error`
    renders without those of a mask, and may be infinite beyond its second argument. As many are left out as together
    cost at most half of `price` (squared error a byte), so that the last one pays as well; none where the price is 0.
    """
    order = np.argsort(guesses - price * sizes, kind="stable")
    most = int(np.count_nonzero(guesses < price * sizes))
    while most:
        trial = np.isin(np.arange(len(sizes)), order[:most])
        worth = price / 2 * float(sizes[trial].sum())
        cost = error(trial, worth)
        if cost <= worth:
            return trial, cost
        most //= 2
    return np.zeros(len(sizes), bool), 0.0


@dataclass(frozen=True, slots=True, eq=False)
class CostSums:
    """Sums over rows of what channels take and what errors they make without their planes; see `estimate_cost`."""

    centres: NDArray[np.float64]  # (c,) in steps
    counts: NDArray[np.int64]  # (c, 2, values) how often the first pictures, and the changes after them, have a value
    errors: NDArray[np.float64]  # (c,) squared differences to the centres, weighed
    weights: NDArray[np.float64]  # (c,) of all rows

    @staticmethod
    def of(centres: NDArray[np.float64]) -> CostSums:
        c = len(centres)
        return CostSums(centres, np.zeros((c, 2, 2 * WIDEST_CHANGE + 1), np.int64), np.zeros(c), np.zeros(c))

    def add(self, values: NDArray[np.float64], weights: NDArray[np.float64]) -> None:
        """Add rows: (T, c, n) values in steps and (c, n) squared error of pictures for a squared step."""
        for c, weight in enumerate(weights):
            v = values[:, c] - self.centres[c]
            self.errors[c] += float(np.square(v).mean(axis=0) @ weight)
            self.weights[c] += float(weight.sum())
            whole = np.rint(v)
            self.counts[c, 0] += _count(whole[:1])
            self.counts[c, 1] += _count(np.diff(whole, axis=0))

    def costs(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return (c,) bytes of each channel, and (c,) errors without it."""
        sizes = [_entropy_bytes(first) + _entropy_bytes(changes) for first, changes in self.counts]
        return np.array(sizes), np.maximum(0.0, self.errors - CODING_VARIANCE * self.weights)


def estimate_cost(values: Values, centres: Values, weights: Values) -> tuple[Values, Values]:
    """Return (c,) bytes that each channel of `values` takes, and (c,) errors if it were constant at its centre.

    `values` (T, c, n) and `centres` (c,) are in steps, `weights` (c, n) are the squared error of pictures for a
    squared step. Bytes are the zero-order entropy of the first picture and of the changes after it; H.264 does a
    little better. Errors are mean squared ones to first order. They take rows as independent, but neighbours that
    change together make more error, so they are only good for ranking.
    """
    sums = CostSums.of(centres)
    sums.add(values, weights)
    return sums.costs()


def _count(whole: NDArray[np.float64]) -> NDArray[np.int64]:
    places = (np.clip(whole, -WIDEST_CHANGE, WIDEST_CHANGE) + WIDEST_CHANGE).astype(np.intp)
    return np.bincount(places.ravel(), minlength=2 * WIDEST_CHANGE + 1)


def _entropy_bytes(counts: NDArray[np.int64]) -> float:
    """Return the zero-order entropy, in bytes, of numbers by how often each occurs."""
    total = int(counts.sum())
    share = counts[counts > 0] / max(1, total)
    return float(-(share * np.log2(share)).sum()) * total / 8

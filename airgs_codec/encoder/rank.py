"""Which rows of a group move, and whose updates matter most. T frames, N rows, C colour channels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airgs_codec.analysis.sensitivity import CODING_VARIANCE, LEAK
from airgs_codec.coding.weights import withheld_error


@dataclass(frozen=True, slots=True, eq=False)
class RowUsage:
    """How much views use the rows of a group, for ranking updates by it."""

    score: NDArray[np.float64]  # (N,) usage, by the measure that ranks rows for key tiers
    hits: NDArray[np.float64]  # (N,) pixels where a row is blended: the paper's usage frequency
    moved: NDArray[np.float64] | None  # (N,) `Usage.moved`, where the trainer left it and `score` is max: max x change

    def take(self, rows: NDArray[np.intp] | slice) -> RowUsage:
        """The usage of some rows, in the order of `rows`."""
        return RowUsage(self.score[rows], self.hits[rows], None if self.moved is None else self.moved[rows])

    def rank(self, name: str, changes: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N,) score of updates: "hits" alone as in the paper, or "usage" x size of the change.

        `changes` (T, 10 + C, N) are differences to the canonical frame, in steps.
        """
        if name == "hits":
            return self.hits
        if self.moved is not None:
            return self.moved
        return self.score * np.sqrt(np.einsum("tcn,tcn->n", changes, changes) / len(changes))


def find_moving(
    states: NDArray[np.float64], changes: NDArray[np.float64], weights: NDArray[np.float64], keep_all: bool
) -> NDArray[np.bool_]:
    """(N,) rows whose states are worth coding; the others are static. Arguments as in `rank_updates`.

    A row is static if it never changes by more than half a step, or, without `keep_all`, if coding its states is
    expected to add more error than it repairs.
    """
    moving: NDArray[np.bool_] = np.abs(changes).max(axis=(0, 1)) > 0.5
    if keep_all:
        return moving
    variance = np.square(states).mean(axis=0, keepdims=True)
    coded = np.minimum(variance + LEAK * np.maximum(CODING_VARIANCE - variance, 0), CODING_VARIANCE)
    return moving & (withheld_error(states, weights) > withheld_error(np.sqrt(coded), weights))


def rank_updates(
    states: NDArray[np.float64],
    changes: NDArray[np.float64],
    weights: NDArray[np.float64],
    usage: RowUsage | None = None,
    rank: str = "error",
    keep_all: bool = False,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(N,) scores that rank updates for pruning, and (N,) whether any level carries a row.

    `states` (T, 10 + C, N) are differences to the canonical frame as decoded, `changes` to the original one, both in
    steps; `weights` (10 + C, N) are the squared error of pictures for a squared step. The score is the error expected
    of withholding the updates of a row, or, where `rank` is another one than "error", that of its `usage`.
    """
    score = withheld_error(changes, weights) if usage is None or rank == "error" else usage.rank(rank, changes)
    return score, find_moving(states, changes, weights, keep_all)

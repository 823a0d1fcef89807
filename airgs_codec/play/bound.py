"""The best that could have been shown: a bound over a whole session.

The paper maximises the quality of each frame under B / R; that separates by frame and is no bound, since bytes saved
now serve later. The bound here is a multiple-choice knapsack with prefix constraints: with F_k the bytes that the
link has carried when slot k is complete, F_k >= max(F_{k-1}, A(release_k)) + bytes_k and F_k <= A(deadline_k), where A
is the integral of the trace. Any player that shows its slots at those deadlines and requests none before its release
(the limit of its buffer) satisfies it, whatever else it fetched, replaced or waited for; so its optimum, and that of
its linear relaxation, is no less than what the player reached. Deadlines and releases ascend together, so that the
order of deadlines is as good as any. Where keyframes of a group are coded as differences from those of another, its
base, keyframes of the base are fetched too, unless an earlier slot of the same loop over the sequence had them.

S slots, R rungs, Q keyframe qualities, K keyframe tiers. Sizes are in kB or larger units, so that numbers are of one
order.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import ConfigError
from airgs_codec.play.offers import NO_KEYFRAMES, Keyframe, Keyframes, SegmentOffer

ROUNDING = 1e-7  # share of a capacity that is added to it: sums of floats must not make a session impossible
MOST_UNITS = 1e6  # of a delta segment: past 1e11 HiGHS finds no solution where there is one
Terms = list[tuple[int, float]]  # (column of a variable, its coefficient)
Row = tuple[Terms, float, float]  # low <= sum of coefficient x variable <= high


@dataclass(frozen=True, slots=True, eq=False)
class Slot:
    """One segment to be shown; capacities are bytes that the link carries from the start of the trace."""

    offer: SegmentOffer
    released: float  # bytes the link has carried when the first byte of the slot may pass
    capacity: float  # bytes the link has carried when the last byte must have passed


class Solution(NamedTuple):
    quality: float  # dB, the mean over time of the slots' PSNR
    first_bytes: float  # fetched for the first slot
    rungs: NDArray[np.float64]  # (K, R) shares of each slot; 0 and 1 when integer


def solve_horizon(
    horizon: Sequence[Slot], decoded: Keyframes = NO_KEYFRAMES, idle_bytes: float = 0.0, integer: bool = False
) -> Solution | None:
    """Find what to show by linear or integer programme (HiGHS); None if even the smallest rungs come too late.

    `horizon`: slots in the order in which they are shown. `decoded` are keyframes that need not be fetched in the loop
    of the first slot. `idle_bytes` is what the link could have carried while it waits for the next request, per slot
    after the first: 0 for a player that sends its next request a round trip before the last batch ends, and in a
    bound. Raises ConfigError for a horizon without slots.
    """
    from scipy.optimize import Bounds, LinearConstraint, milp  # no other part of a player needs it
    from scipy.sparse import csr_array

    if not horizon:
        raise ConfigError("horizon: expected at least one slot")
    programme = _Programme(horizon, decoded, idle_bytes)
    slots, width, rungs = range(len(horizon)), programme.width, programme.rungs
    total = sum(slot.offer.seconds for slot in horizon)
    costs, upper = np.zeros((len(slots), width)), np.ones((len(slots), width))
    for k, slot in enumerate(horizon):
        costs[k, :rungs] = -slot.offer.psnr * slot.offer.seconds / total
        upper[k, :rungs] = [rung.allowed for rung in slot.offer.rungs]
        upper[k, -1] = slot.capacity * (1 + ROUNDING) / programme.unit
    terms, low, high = zip(*(row for k in slots for row in programme.rows(k)), strict=True)
    columns, values = zip(*itertools.chain.from_iterable(terms), strict=True)
    ends = np.cumsum([0, *map(len, terms)])
    matrix = csr_array((values, columns, ends), shape=(len(terms), costs.size))
    limits, bounds = LinearConstraint(matrix, np.array(low), np.array(high)), Bounds(0.0, upper.ravel())
    whole = np.tile(np.r_[np.ones(width - 1, np.int64), 0], len(slots)) * int(integer)
    result = milp(costs.ravel(), constraints=limits, bounds=bounds, integrality=whole)
    if result.x is None:
        return None
    first = sum(size * result.x[column] for column, size in programme.fetched(0))
    shares = result.x.reshape(len(slots), width)[:, :rungs]
    return Solution(float(-result.fun), programme.unit * float(first), shares)


class _Programme:
    """Variables and constraints. Slot k has R shares of rungs, Q K shares of keyframes that are decoded, and F_k in
    units.

    Where any group has a base, Q K shares of keyframes of the base that are decoded come before F_k.
    """

    def __init__(self, horizon: Sequence[Slot], decoded: Keyframes, idle_bytes: float) -> None:
        self._horizon, self._decoded, self._idle_bytes = horizon, decoded, idle_bytes
        self._offers = [slot.offer for slot in horizon]
        first = self._offers[0]
        keyframes = {of.keyframe for rung in first.rungs for of in rung.keyframes}
        own = sorted(keyframe[1:] for keyframe in keyframes if keyframe[0] == first.group)
        self._column = {key: column for column, key in enumerate(own)}  # of (quality, tier)
        self.rungs = len(first.rungs)
        self._groups = [(offer.group, offer.base) for offer in self._offers]
        self._loops = np.cumsum([0, *(b.segment <= a.segment for a, b in itertools.pairwise(self._offers))])
        self._bytes = {of.keyframe: of.bytes for offer in self._offers for rung in offer.rungs for of in rung.keyframes}
        kinds = 1 if all(base is None for _, base in self._groups) else 2
        largest = max(float(rung.delta_bytes) for offer in self._offers for rung in offer.rungs)
        self.unit = max(1e3, largest / MOST_UNITS)  # bytes
        self.width = self.rungs + kinds * len(own) + 1

    def _keyframe(self, k: int, of: int, keyframe: tuple[int, int]) -> int:
        """Return the column of a keyframe's decoded share, for slot k's group (of = 0) or its base (of = 1)."""
        return k * self.width + self.rungs + of * len(self._column) + self._column[keyframe]

    def _keyframes(self, k: int) -> Iterator[tuple[Keyframe, int, int | None]]:
        """Yield all keyframes that slot k may need, each with its column and its column in the last slot before k."""
        for of, group in enumerate(self._groups[k]):
            for key in self._column:
                if group is not None:
                    yield (group, *key), self._keyframe(k, of, key), self._before(k, of, key)

    def _before(self, k: int, of: int, keyframe: tuple[int, int]) -> int | None:
        """Return the column of the same keyframe in the last slot before k that may need it, None if none does."""
        if of == 0:
            return self._keyframe(k - 1, of, keyframe) if k and not self._offers[k].starts_group else None
        group = self._groups[k][of]
        for i in range(k - 1, -1, -1):
            if self._loops[i] != self._loops[k]:
                break
            if group in self._groups[i]:
                return self._keyframe(i, self._groups[i].index(group), keyframe)
        return None

    def rows(self, k: int) -> Iterator[Row]:
        """Yield the constraints of slot k: one rung with its keyframes, downloaded after its release and slot k - 1."""
        slot, first, carried = self._horizon[k], k * self.width, (k + 1) * self.width - 1
        yield [(first + rung, 1.0) for rung in range(self.rungs)], 1.0, 1.0
        users: dict[Keyframe, Terms] = defaultdict(list)  # minus the share of every rung that needs a keyframe
        for number, rung in enumerate(slot.offer.rungs):
            for needed in rung.keyframes:
                users[needed.keyframe].append((first + number, -1.0))
        for keyframe, share, before in self._keyframes(k):
            if users[keyframe]:
                yield [(share, 1.0), *users[keyframe]], 0.0, np.inf
            if before is not None:
                yield [(share, 1.0), (before, -1.0)], 0.0, np.inf
        done = [(carried, 1.0), *((column, -size) for column, size in self.fetched(k))]
        yield done, slot.released / self.unit, np.inf
        if k:
            yield [*done, (first - 1, -1.0)], self._idle_bytes / self.unit, np.inf

    def fetched(self, k: int) -> Terms:
        """Return the bytes fetched for slot k, in units, as coefficients of the variables."""
        rungs = self._offers[k].rungs
        fetched = [(k * self.width + number, rung.delta_bytes / self.unit) for number, rung in enumerate(rungs)]
        for keyframe, share, before in self._keyframes(k):
            if not self._loops[k] and keyframe in self._decoded:
                continue
            size = self._bytes.get(keyframe, 0) / self.unit
            fetched.append((share, size))
            if before is not None:
                fetched.append((before, -size))
        return fetched

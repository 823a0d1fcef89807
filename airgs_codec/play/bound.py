"""What could have been shown at best: the paper's integer programme, and a bound over the whole session.

The paper maximises the quality of each frame under B / R; that separates by frame and is no bound, since bytes saved
now serve later. The bound here is a multiple-choice knapsack with prefix constraints: with F_k the bytes that the
link has carried when unit k is there, F_k >= max(F_{k-1}, A(release_k)) + bytes_k and F_k <= A(deadline_k), where A
is the integral of the trace. Any player that shows its units at those deadlines and asks for none before its release
(the limit of its buffer) satisfies it, whatever else it fetched, replaced or waited for; so its optimum, and that of
its linear relaxation, is no less than what the player reached. Units need not be fetched in order: deadlines and
releases ascend together, and then the order of deadlines is as good as any.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csr_array

from airgs_codec.errors import ConfigError
from airgs_codec.play.catalogue import Catalogue
from airgs_codec.play.link import Link

ROUNDING = 1e-7  # share of a capacity that is added to it: sums of floats must not make a session impossible


@dataclass(frozen=True, slots=True)
class Unit:
    """One segment of the horizon; capacities are bytes the link carries from the start of the trace."""

    segment: int  # in the package
    opens: bool  # begins a group: no key of it is at hand
    released: float  # what has passed before it may begin
    capacity: float  # what has passed when it must be there


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A solution."""

    quality: float  # dB, mean over time
    first_bytes: float  # of the first unit
    rungs: NDArray[np.float64]  # (K, R) shares; 0 and 1 when integer


class _Rules(Protocol):
    """The part of a player's state that `Horizon.ahead` needs."""

    @property
    def now_s(self) -> float: ...
    @property
    def buffer_limit_s(self) -> float: ...


@dataclass(frozen=True, slots=True, eq=False)
class Horizon:
    """What is to be chosen: units in order, and what is at hand of the first unit's group."""

    catalogue: Catalogue
    units: tuple[Unit, ...]
    held: Mapping[int, int]
    overhead: float = 0.0  # bytes a unit, for the round trip in which nothing passes; 0 in a bound

    @staticmethod
    def ahead(
        catalogue: Catalogue,
        link: Link,
        position: int,
        end: int,
        held: Mapping[int, int],
        deadline_s: float,
        rules: _Rules,
    ) -> Horizon:
        """From a moment of a session to its end, shown without a stall from `deadline_s` on, at most 2 buffers long."""
        units: list[Unit] = []
        start = deadline_s
        for segment, opens in catalogue.upcoming(position, end - position, end):
            seconds = catalogue.seconds[segment]
            release = max(rules.now_s, start + seconds - rules.buffer_limit_s) + link.rtt_s
            units.append(Unit(segment, opens, link.bytes_between(0.0, release), link.bytes_between(0.0, start)))
            start += seconds
            if start > deadline_s + 2 * rules.buffer_limit_s:
                break
        return Horizon(catalogue, tuple(units), held, link.rtt_s * link.trace.mean_bps / 8)


def solve_horizon(horizon: Horizon, integer: bool = False) -> Plan | None:
    """The best plan, as linear or integer programme (HiGHS); None if even the smallest rungs come too late.

    Variables of unit k: a share of every rung, how much of every key (quality, tier) is at hand, F_k in kB.
    """
    c = horizon.catalogue
    m = c.manifest
    rungs, tiers = len(c.rungs), m.tier_count
    keys = len(m.qualities) * tiers
    width = rungs + keys + 1
    count = len(horizon.units)
    if not count:
        raise ConfigError("horizon: expected at least one unit")
    build = _Rows()
    objective = np.zeros((count, width))
    upper = np.ones((count, width))
    total = sum(c.seconds[unit.segment] for unit in horizon.units)
    for k, unit in enumerate(horizon.units):
        base = k * width
        objective[k, :rungs] = -c.quality[unit.segment] * c.seconds[unit.segment] / total
        upper[k, -1] = unit.capacity * (1 + ROUNDING) / 1e3
        build.add([(base + r, 1.0) for r in range(rungs)], 1.0, 1.0)
        for q in range(len(m.qualities)):
            for t in range(tiers):
                uses = [r for r, (quality, j) in enumerate(c.rungs) if quality == q and m.levels[j].tiers > t]
                at = base + rungs + q * tiers + t
                build.add([(at, 1.0), *((base + r, -1.0) for r in uses)], 0.0, np.inf)
                if k and not unit.opens:
                    build.add([(at, 1.0), (at - width, -1.0)], 0.0, np.inf)
        spent, known = _spending(horizon, k, width, rungs, tiers)
        arrives = [(base + width - 1, 1.0), *((at, -size) for at, size in spent)]
        build.add(arrives, unit.released / 1e3 + known, np.inf)
        if k:
            build.add([*arrives, (base - 1, -1.0)], known, np.inf)
    result = milp(
        objective.ravel(),
        constraints=build.constraint(count * width),
        bounds=Bounds(0.0, upper.ravel()),
        integrality=np.tile(np.r_[np.full(rungs + keys, int(integer)), 0], count),
    )
    if result.x is None:
        return None
    values = result.x.reshape(count, width)
    spent, known = _spending(horizon, 0, width, rungs, tiers)
    first = 1e3 * (known + sum(size * result.x[at] for at, size in spent)) - horizon.overhead
    return Plan(float(-result.fun), float(first), values[:, :rungs])


def _spending(horizon: Horizon, k: int, width: int, rungs: int, tiers: int) -> tuple[list[tuple[int, float]], float]:
    """kB of unit k: (variable, kB for each unit of it), and what is constant."""
    c, unit = horizon.catalogue, horizon.units[k]
    base = k * width
    group = c.manifest.segments[unit.segment].group
    spent = [(base + r, float(c.state_bytes[unit.segment, j]) / 1e3) for r, (_, j) in enumerate(c.rungs)]
    known = horizon.overhead / 1e3
    for q in range(len(c.manifest.qualities)):
        for t in range(tiers):
            size = float(c.key_bytes[group, q, t]) / 1e3
            at = base + rungs + q * tiers + t
            spent.append((at, size))
            if k and not unit.opens:
                spent.append((at - width, -size))
            elif not k and horizon.held.get(q, 0) > t:
                spent[-1] = (at, 0.0)
    return spent, known


class _Rows:
    """Sparse constraints, row by row."""

    def __init__(self) -> None:
        self._columns: list[int] = []
        self._values: list[float] = []
        self._ends: list[int] = [0]
        self._low: list[float] = []
        self._high: list[float] = []

    def add(self, entries: Sequence[tuple[int, float]], low: float, high: float) -> None:
        for column, value in entries:
            self._columns.append(column)
            self._values.append(value)
        self._ends.append(len(self._columns))
        self._low.append(low)
        self._high.append(high)

    def constraint(self, width: int) -> LinearConstraint:
        matrix = csr_array((self._values, self._columns, self._ends), shape=(len(self._low), width))
        return LinearConstraint(matrix, np.array(self._low), np.array(self._high))


def paper_programme(sizes: ArrayLike, qualities: ArrayLike, budgets: ArrayLike) -> tuple[float, NDArray[np.bool_]]:
    """The paper's integer programme over n frames of L levels, (n, L), (n, L), (n,) bytes, solved with HiGHS.

    Gives the sum of qualities over the frames for which a level fits, and (n,) which those are: where none does, the
    programme as printed has no solution.
    """
    size, quality = np.asarray(sizes, np.float64), np.asarray(qualities, np.float64)
    budget = np.asarray(budgets, np.float64)
    feasible: NDArray[np.bool_] = np.any(size <= budget[:, None], axis=1)
    n, levels = int(feasible.sum()), size.shape[1]
    if not n:
        return 0.0, feasible
    rows = _Rows()
    for i, frame in enumerate(np.flatnonzero(feasible)):
        rows.add([(i * levels + j, 1.0) for j in range(levels)], 1.0, 1.0)
        rows.add([(i * levels + j, size[frame, j]) for j in range(levels)], -np.inf, budget[frame])
    result = milp(
        -quality[feasible].ravel(),
        constraints=rows.constraint(n * levels),
        bounds=Bounds(0.0, 1.0),
        integrality=np.ones(n * levels),
    )
    return float(-result.fun), feasible

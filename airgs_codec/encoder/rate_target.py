"""The quality factor at which a package reaches a PSNR or a size."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from airgs_codec.errors import ConfigError

PSNR, SIZE = "PSNR", "kB/frame"
TOLERANCES = {PSNR: 0.1, SIZE: 0.01}  # of a search, in dB and as a share; finished packages differ by a little
# How PSNR and the logarithm of the size change with the logarithm of the factor, before two trials say it better:
# error grows with the square of the steps; sizes were seen to fall by 0.6 to 1.
SLOPES = {PSNR: -20 / math.log(10), SIZE: -0.75}
TRIALS = 8
ENOUGH = 2.5  # tolerances by which the best of all trials may miss
FACTORS = 0.01, 100.0  # least and largest quality factor that is tried


class OutOfReachError(ConfigError):
    """A goal that no quality factor meets."""

    def __init__(self, goal: Goal, got: float, factor: float, why: str = "") -> None:
        near = f"{got:.4g} at quality factor {factor:.3g}"
        super().__init__(f"target: {goal.value:g} {goal.kind} is out of reach, the nearest was {near}{why}")
        self.got = got
        self.factor = factor


@dataclass(frozen=True, slots=True)
class Goal:
    """What the top rung is to reach."""

    kind: str  # PSNR or SIZE
    value: float  # dB, or kB a frame

    def __post_init__(self) -> None:
        if not 0 < self.value < math.inf:
            raise ConfigError(f"target: expected a positive {self.kind}, got {self.value:g}")

    def misses(self, got: float) -> float:
        """By how many tolerances `got` misses the goal; positive: it is above."""
        wide = TOLERANCES[self.kind]
        return (got - self.value) / wide if self.kind == PSNR else math.log(got / self.value) / wide


def find_quality(goal: Goal, trial: Callable[[float], float], start: float) -> float:
    """A quality factor at which `trial` gives what the goal asks for; the search begins at `start`.

    It is met to TOLERANCES, or to ENOUGH of them after TRIALS trials. The search steps by SLOPES until two trials lie
    on both sides of the goal, then by regula falsi between the nearest two: trials are noisy by about a tolerance, so
    no slope between two of them can be trusted. Raises OutOfReachError.
    """
    slope = SLOPES[goal.kind] / TOLERANCES[goal.kind]
    seen: dict[float, float] = {}
    factor = start
    for _ in range(TRIALS):
        seen[factor] = goal.misses(trial(factor))
        if abs(seen[factor]) <= 1:
            return factor
        factor = min(max(_next_factor(seen, slope), FACTORS[0]), FACTORS[1])
        if factor in seen:
            break
    best = min(seen, key=lambda f: abs(seen[f]))
    if abs(seen[best]) <= ENOUGH:
        return best
    wide = TOLERANCES[goal.kind]
    got = goal.value + seen[best] * wide if goal.kind == PSNR else goal.value * math.exp(seen[best] * wide)
    raise OutOfReachError(goal, got, best)


def _next_factor(seen: dict[float, float], slope: float) -> float:
    """The next factor to try, from the misses of those tried; a positive miss asks for a larger factor."""
    above = [f for f in seen if seen[f] > 0]
    below = [f for f in seen if seen[f] < 0]
    if above and below:
        fine, coarse = max(above), min(below)
        share = seen[fine] / (seen[fine] - seen[coarse])
        return fine * (coarse / fine) ** min(max(share, 0.1), 0.9)
    factor = max(above) if above else min(below)
    return factor * min(max(math.exp(-seen[factor] / slope), 0.25), 4.0)

"""The quality factor at which a package reaches a PSNR or a size."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from airgs_codec.errors import ConfigError

PSNR, SIZE = "PSNR", "kB/frame"
TOLERANCES = {PSNR: 0.1, SIZE: 0.01}  # dB, share: of a search; finished packages differ by a little
# How PSNR and the logarithm of the size change with the logarithm of the factor, before two trials say it better:
# error grows with the square of the steps; sizes were seen to fall by 0.6 to 1.
SLOPES = {PSNR: -20 / math.log(10), SIZE: -0.75}
TRIALS = 8
FACTORS = 0.01, 100.0


@dataclass(frozen=True, slots=True)
class Goal:
    """What the top rung is to reach."""

    kind: str  # PSNR or SIZE
    value: float  # dB, or kB a frame

    def __post_init__(self) -> None:
        if not 0 < self.value < math.inf:
            raise ConfigError(f"target: expected a positive {self.kind}, got {self.value:g}")

    def misses(self, got: float) -> float:
        """How far, in tolerances of a search, with sign."""
        wide = TOLERANCES[self.kind]
        return (got - self.value) / wide if self.kind == PSNR else math.log(got / self.value) / wide


def find_quality(goal: Goal, trial: Callable[[float], float], start: float) -> float:
    """A factor at which `trial` gives what the goal asks for, to TOLERANCES; the secant method, bounded.

    Raises ConfigError when TRIALS do not come near: the goal is out of reach.
    """
    factor, slope = start, SLOPES[goal.kind] / TOLERANCES[goal.kind]
    seen: dict[float, float] = {}
    for _ in range(TRIALS):
        seen[factor] = goal.misses(trial(factor))
        if abs(seen[factor]) <= 1:
            return factor
        if len(seen) > 1:
            (a, miss_a), (b, miss_b) = list(seen.items())[-2:]
            measured = (miss_b - miss_a) / math.log(b / a)
            slope = min(max(measured, 2 * slope), slope / 2)  # both negative: within a factor of 2 of the last
        factor = min(max(factor * math.exp(-seen[factor] / slope), factor / 4, FACTORS[0]), factor * 4, FACTORS[1])
        if factor in seen:
            break
    best = min(seen, key=lambda f: abs(seen[f]))
    if abs(seen[best]) <= 2:
        return best
    wide = TOLERANCES[goal.kind]
    got = goal.value + seen[best] * wide if goal.kind == PSNR else goal.value * math.exp(seen[best] * wide)
    raise ConfigError(
        f"target: {goal.value:g} {goal.kind} is out of reach, the nearest was {got:.4g} at quality factor {best:.3g}"
    )

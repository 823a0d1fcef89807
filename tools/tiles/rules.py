"""Which rung of every tile a player fetches: rules, one a row of the table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from tools.tiles.split import Tile
from tools.tiles.viewer import Watcher, distance, in_sight, moments

LEADS, MARGINS = (0.3, 0.5, 1.0, 3.0), (0.0, 15.0, 30.0, 45.0, 75.0)  # seconds, degrees
Choice = tuple[int | None, ...]  # of each tile its place on the ladder, from the best down; None: nothing


@dataclass(frozen=True, slots=True)
class Rule:
    """What a player does for a segment that it fetches `lead` seconds before it is shown.

    Tiles that are expected in sight, within `margin` degrees of the picture, have rung `base`. The others have the last
    rung (`coarse`) or nothing. With `by_distance`, what is further away than the nearest tile in sight may be as much
    coarser as it is further.
    """

    name: str
    base: int
    coarse: bool = False
    margin: float = 15.0
    lead: float | None = 1.0  # None: it knows what will be in sight
    by_distance: bool = False

    def choose(
        self, tiles: Sequence[Tile], watcher: Watcher, span: tuple[float, float], factors: Sequence[float]
    ) -> Choice:
        """The choice for a segment that is shown in [start, stop); `factors` are those of the ladder's steps."""
        now = math.inf if self.lead is None else span[0] - self.lead
        views = [watcher.expected(now, later) for later in moments(*span)]
        seen = [any(in_sight(tile, view, self.margin) for view in views) for tile in tiles]
        away = [min(distance(tile, view) for view in views) for tile in tiles]
        nearest = max(min((a for a, s in zip(away, seen, strict=True) if s), default=0.0), 1e-6)
        out = len(factors) - 1 if self.coarse else None
        return tuple(
            self._rung(a / nearest if self.by_distance else 1.0, factors) if s else out
            for a, s in zip(away, seen, strict=True)
        )

    def _rung(self, further: float, factors: Sequence[float]) -> int:
        most = max(1.0, further) * factors[self.base] * (1 + 1e-6)
        return max(j for j, factor in enumerate(factors) if j == self.base or (j > self.base and factor <= most))


def rules_of(rungs: int) -> list[Rule]:
    """The rules that are compared: some over all rungs, others about the second best one."""
    ladder = range(rungs)
    middle = min(1, rungs - 1)
    return [
        *(Rule("in sight, nothing else", base) for base in ladder),
        *(Rule("in sight, the rest coarse", base, coarse=True) for base in ladder),
        *(Rule("margin 45, the rest coarse", base, coarse=True, margin=45.0) for base in ladder),
        *(Rule("known in advance", base, margin=5.0, lead=None) for base in ladder),
        *(Rule("known, by distance", base, margin=5.0, lead=None, by_distance=True) for base in ladder),
        *(Rule(f"lead {s:g} s, margin {m:g}", middle, lead=s, margin=m) for s in LEADS for m in MARGINS),
    ]

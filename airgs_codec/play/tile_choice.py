"""Which tiles a player fetches that knows how its viewer moves: early with their segment, late what is then lacking.

Early, when a segment is asked for, those that the picture is expected to show while the segment is shown. Nobody can
tell more than a second ahead how a viewer turns, so that tiles will be lacking; what a wider picture is expected to
show soon before it is shown is fetched then. Measured in docs/results/tiles.md.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from airgs_codec.play.catalogue import Catalogue
from airgs_codec.play.playout import Playout, Slot
from airgs_codec.play.sight import BEFORE_S, Boxes, Velocity, View, expected
from airgs_codec.scene.camera import Camera

EARLY_MARGIN, LATE_MARGIN = 0.0, 30.0  # degrees beside the expected picture
FURTHEST_S = 1.0  # no picture is expected further ahead
SOON_S = 0.3  # before its start, a segment is looked at again


@dataclass(slots=True, eq=False)
class TileChoice:
    """The choice of tiles for a session. Times are those of the session, and nothing after them is looked at."""

    catalogue: Catalogue
    playout: Playout
    view: View
    _boxes: dict[int, Boxes] = field(default_factory=dict)  # by group

    def early(self, position: int, now_s: float) -> list[int]:
        """The tiles to fetch with the next segment, those nearest to the middle of the picture first; never none."""
        start_s = self.playout.buffer_end_s(now_s)
        off = self._off(position, now_s, (start_s, start_s + self.catalogue.seconds_at(position)))
        return [tile for tile in _nearest(off) if off[tile] <= max(EARLY_MARGIN, float(off.min()))]

    def lacking(self, now_s: float) -> Iterator[tuple[Slot, int]]:
        """Segments with tiles to fetch late, the first segment first, then what is nearest to the middle."""
        for slot in self.playout.unfinished(now_s):
            if slot.start_s > now_s + SOON_S:
                return
            off = self._off(slot.position, now_s, (slot.start_s, self.playout.end_s(slot)))
            yield from ((slot, t) for t in _nearest(off) if off[t] <= LATE_MARGIN and t not in slot.tiles)

    def _off(self, position: int, now_s: float, span: tuple[float, float]) -> NDArray[np.float64]:
        """(P,) degrees that each tile is beside the pictures expected of a span of time; inf for one without rows."""
        group = self.catalogue.group(position)[1]
        if group not in self._boxes:
            self._boxes[group] = Boxes.of_tiles(self.catalogue.manifest.groups[group])
        return self._boxes[group].nearest(self._expected(now_s, span))

    def _expected(self, now_s: float, span: tuple[float, float]) -> Iterator[Camera]:
        """The pictures expected at the start, in the middle and at the end of a span, as far as can be told."""
        here = self._seen(now_s)
        velocity = Velocity.between(self._seen(now_s - BEFORE_S), here)
        start_s, stop_s = (max(now_s, at_s) for at_s in span)
        for at_s in dict.fromkeys((start_s, (start_s + stop_s) / 2, stop_s)):
            yield expected(here, velocity, min(at_s - now_s, FURTHEST_S))

    def _seen(self, at_s: float) -> Camera:
        """What the viewer saw at a moment; before the first picture he stands still."""
        timeline = self.playout.timeline
        return self.view.at(max(0.0, at_s - timeline[0].start_s) if timeline else 0.0)


def _nearest(off: NDArray[np.float64]) -> list[int]:
    """The tiles that can be seen at all, the nearest first."""
    return [int(tile) for tile in np.argsort(off, kind="stable") if np.isfinite(off[tile])]

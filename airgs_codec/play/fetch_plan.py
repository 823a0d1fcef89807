"""What is fetched of a segment, in which order, and what may be left for later.

By view, a player fetches the tiles that the picture is expected to show while the segment is shown, early: when the
segment is asked for. Nobody can tell more than a second ahead how a viewer turns, so that tiles will be lacking; what a
wider picture is expected to show soon before it is shown is fetched late. Measured in docs/results/tiles.md.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airgs_codec.play.offers import SegmentOffer, Tiles
from airgs_codec.play.playout import Playout, Slot
from airgs_codec.play.sight import BEFORE_S, Velocity, View, expected
from airgs_codec.scene.camera import Camera

EARLY_MARGIN, LATE_MARGIN = 0.0, 30.0  # degrees beside the expected picture
FURTHEST_S = 1.0  # no picture is expected further ahead
SOON_S = 0.3  # before its start, a segment is looked at again
LOOK_S = 0.05  # a player that waits looks so often what is lacking

Part = Tiles | None  # tiles that are fetched together; None: all


@dataclass(frozen=True, slots=True)
class FetchPlan:
    """The order in which a player fetches. Times are those of the session, and nothing after them is looked at.

    Without a view: all tiles of a segment together; while there is time, what is buffered is replaced by better rungs.
    With one: tile after tile, each by itself, in the rung that is chosen for all of them, so that what the segments
    before it turn out to lack need not wait. Nothing that is buffered is replaced: the buffer is short.
    """

    view: View | None = None

    @property
    def all_at_once(self) -> bool:
        """Whether no tile is left for later."""
        return self.view is None

    def early(self, offer: SegmentOffer, playout: Playout, now_s: float) -> list[Part]:
        """What to fetch of the next segment, one part after another: tiles nearest to the middle of the picture first.

        There are none where no tile has rows.
        """
        if self.view is None:
            return [None]
        start_s = playout.buffer_end_s(now_s)
        off = self._off(offer, playout, now_s, (start_s, start_s + offer.seconds))
        return [frozenset({tile}) for tile in _nearest(off) if off[tile] <= max(EARLY_MARGIN, float(off.min()))]

    def lacking(self, playout: Playout, now_s: float) -> Iterator[tuple[Slot, int]]:
        """Segments with tiles to fetch late, the first segment first, then what is nearest to the middle."""
        for slot, offer in playout.unfinished(now_s) if self.view else ():
            if slot.start_s > now_s + SOON_S:
                return
            off = self._off(offer, playout, now_s, (slot.start_s, slot.end_s))
            yield from ((slot, t) for t in _nearest(off) if off[t] <= LATE_MARGIN and t not in slot.tiles)

    def _off(
        self, offer: SegmentOffer, playout: Playout, now_s: float, span: tuple[float, float]
    ) -> NDArray[np.float64]:
        """(P,) degrees that each tile is beside the pictures expected of a span of time; inf for one without rows."""
        return offer.boxes.nearest(self._expected(playout, now_s, span))

    def _expected(self, playout: Playout, now_s: float, span: tuple[float, float]) -> Iterator[Camera]:
        """The pictures expected at the start, in the middle and at the end of a span, as far as can be told."""
        here = self._seen(playout, now_s)
        velocity = Velocity.between(self._seen(playout, now_s - BEFORE_S), here)
        start_s, stop_s = (max(now_s, at_s) for at_s in span)
        for at_s in dict.fromkeys((start_s, (start_s + stop_s) / 2, stop_s)):
            yield expected(here, velocity, min(at_s - now_s, FURTHEST_S))

    def _seen(self, playout: Playout, at_s: float) -> Camera:
        """Return what the viewer saw at a moment; before the first picture he stands still."""
        assert self.view is not None
        return self.view.at(max(0.0, at_s - playout.began_s))


def _nearest(off: NDArray[np.float64]) -> list[int]:
    """The tiles that can be seen at all, the nearest first."""
    return [int(tile) for tile in np.argsort(off, kind="stable") if np.isfinite(off[tile])]

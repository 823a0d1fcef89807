"""Which tiles were on the screen of a session that fetched them by view, and which were lacking in sight."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from airgs_codec.package.paths import locate
from airgs_codec.play.catalogue import Catalogue
from airgs_codec.play.events import Shown, TileReady
from airgs_codec.play.sight import Boxes, View
from airgs_codec.play.ticks import screen_ticks, tick_times

There = dict[int, int]  # tile -> rung


def tile_of(path: str) -> int | None:
    """The tile that a file of a key unit or a state is of; None of any other file."""
    what, numbers = locate(path)
    return max(0, numbers[0] - 1) if what in ("sidecar", "key", "state") else None


@dataclass(frozen=True, slots=True)
class TileFigures:
    """Figures of the tiles of one session."""

    tiles: int  # of the package
    fetched: float  # share of the tiles of all segments shown, of those that have rows
    late: int  # tiles that came after their segment had begun
    missing_s: float  # seconds of display in which a tile in sight was lacking
    bytes: tuple[int, ...]  # of every tile, keys and states that were of use, without headers


@dataclass(frozen=True, eq=False)
class TilesShown:
    """The tiles of a session, position by position."""

    catalogue: Catalogue
    view: View
    shown: tuple[Shown, ...]  # one for each position
    ready: tuple[TileReady, ...]
    bytes_by_tile: Mapping[int, int]

    @cached_property
    def _by_position(self) -> dict[int, list[TileReady]]:
        found: dict[int, list[TileReady]] = defaultdict(list)
        for event in self.ready:
            found[event.position].append(event)
        return found

    def came(self, position: int) -> list[TileReady]:
        """What came of the segment at a position."""
        return self._by_position.get(position, [])

    def there(self, position: int, at_s: float) -> There:
        """The tiles of the segment at a position that can be shown at a moment, each with its rung."""
        return {event.tile: event.rung for event in self.came(position) if event.ready_s <= at_s}

    @cached_property
    def tick_times(self) -> NDArray[np.float64]:
        """Seconds from the first request to every display tick."""
        return tick_times(self.shown, self.catalogue.fps)

    @property
    def view_times(self) -> NDArray[np.float64]:
        """Seconds from the first picture to every display tick."""
        return self.tick_times - self.tick_times[0]

    @cached_property
    def missing(self) -> NDArray[np.bool_]:
        """(n, P) tiles that are in sight at a display tick and lacking; none of a lost segment."""
        ticks = screen_ticks(self.shown, self.catalogue.fps)
        found = np.zeros((len(ticks), self.catalogue.manifest.tiles), np.bool_)
        for tick, ((position, _), at_s) in enumerate(zip(ticks, self.view_times.tolist(), strict=True)):
            entry = self.shown[position]
            if entry.rung is not None:
                found[tick] = self._boxes_of(entry.segment).in_sight(self.view.at(at_s), 0.0)
                found[tick, list(self.there(position, float(self.tick_times[tick])))] = False
        return found

    @cached_property
    def _boxes(self) -> dict[int, Boxes]:
        return {}

    def _boxes_of(self, segment: int) -> Boxes:
        m = self.catalogue.manifest
        group = m.group_of(segment)
        if group not in self._boxes:
            self._boxes[group] = Boxes.of_tiles(m.groups[group])
        return self._boxes[group]

    @cached_property
    def figures(self) -> TileFigures:
        """Figures of the session."""
        m = self.catalogue.manifest
        rows = sum(int(self._boxes_of(s.segment).has_rows.sum()) for s in self.shown if s.rung is not None)
        late = [event for event in self.ready if event.ready_s > self.shown[event.position].start_s]
        return TileFigures(
            tiles=m.tiles,
            fetched=len({(event.position, event.tile) for event in self.ready}) / max(1, rows),
            late=len(late),
            missing_s=float(self.missing.any(axis=1).sum() / self.catalogue.fps),
            bytes=tuple(self.bytes_by_tile.get(tile, 0) for tile in range(m.tiles)),
        )

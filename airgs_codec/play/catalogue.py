"""What a package offers a viewer, as numbers: wire bytes and qualities of every choice, for players and bounds.

S segments, G groups, P tiles, K key units, Q key qualities, L levels. A unit is a key tier of a tile, those of the
first tile come first. A rung is a key quality with a level; rungs are numbered quality by quality. A position is a
segment of a session, which may play the sequence several times.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import ConfigError, FormatError
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.package import Package
from airgs_codec.package.paths import JSON_NAME
from airgs_codec.play.events import Batch
from airgs_codec.play.ladder import Option, saved_shares
from airgs_codec.play.rows import Rows
from airgs_codec.play.units import NONE, KeyUnits, Tiles, absent

SESSION_S = 30.0  # of play
HEADER_BYTES = 350  # HTTP response headers a file
KEPT_PARTS = 16  # catalogues of some of the tiles, those asked for last
OVER_BUDGET = 1 << 50  # bytes of a rung that shows too many Gaussians: more than any link carries


@dataclass(eq=False)
class Catalogue:
    """What a package offers. Wire bytes are those of files with `header_bytes` for each.

    A session over a growing package (`live`) begins with its newest group and goes on while `grow` is called.
    No rung is offered that shows more Gaussians than the `budget` has. With `tiles`, sizes are those of these tiles
    alone (`of_tiles`); qualities and numbers of Gaussians are those of all.
    """

    manifest: Manifest
    header_bytes: int = HEADER_BYTES
    root_bytes: int = 0  # of airgs.json
    live: bool = False  # more groups may come in this session
    first: int = 0  # the segment that a session begins with
    budget: int | None = None  # Gaussians that a picture may show at most; None: any number
    tiles: Tiles | None = None  # None: all

    @staticmethod
    def of(package: Package) -> Catalogue:
        """The catalogue of an open package."""
        return Catalogue(package.manifest, root_bytes=package.root_bytes)

    def grow(self, manifest: Manifest, root_bytes: int) -> None:
        """Go on with the tables of the same package, to which groups were added."""
        self.manifest, self.root_bytes, self.live = manifest, root_bytes, manifest.live
        self._parts.clear()

    def limit(self, budget: int | None) -> None:
        """Show at most so many Gaussians from now on; None: any number."""
        for name in ("_options", "bytes_after", "bytes_from_scratch") if budget != self.budget else ():
            self.__dict__.pop(name, None)
        self.budget = budget
        self._parts.clear()

    def of_tiles(self, tiles: Iterable[int]) -> Catalogue:
        """What some tiles cost: the same with their sizes."""
        chosen = frozenset(tiles)
        if len(chosen) == self.manifest.tiles:
            return self
        part = self._parts.pop(chosen, None) or replace(self, tiles=chosen)
        self._parts[chosen] = part  # the last of them
        if len(self._parts) > KEPT_PARTS:
            self._parts.pop(next(iter(self._parts)))
        return part

    @cached_property
    def _parts(self) -> dict[Tiles, Catalogue]:
        return {}  # the one asked for last is the last

    def check_budget(self, segments: Iterable[int]) -> None:
        """Raises ConfigError where every rung of one of these segments shows more Gaussians than the budget has."""
        if self.budget is None:
            return
        least = max((int(self.rows[segment].min()) for segment in segments if self._knows(segment)), default=0)
        if least > self.budget:
            raise ConfigError(f"budget: expected {least} Gaussians or more, got {self.budget}")

    @cached_property
    def _options(self) -> dict[tuple[Any, ...], tuple[Option, ...]]:
        return {}

    @cached_property
    def rungs(self) -> list[tuple[int, int]]:
        """(key quality, level) of every rung."""
        return [(q, j) for q in range(len(self.manifest.qualities)) for j in range(len(self.manifest.levels))]

    @cached_property
    def names(self) -> list[str]:
        """The name of every rung, such as Q1+L2."""
        m = self.manifest
        return [f"{m.qualities[q].id}+{m.levels[j].id}" for q, j in self.rungs]

    @cached_property
    def fps(self) -> float:
        """Frames a second."""
        return float(self.manifest.fps)

    @property
    def segments(self) -> int:
        """How many segments there are, S."""
        return len(self.manifest.segments)

    @property
    def duration_s(self) -> float:
        """Seconds of play of the whole sequence."""
        return self.manifest.frames / self.fps

    @property
    def measured(self) -> bool:
        """Whether every rung of every segment has a quality."""
        return self.manifest.measured

    @property
    def newest_seconds(self) -> float:
        """Seconds of play of the last group so far."""
        entry = self.manifest.groups.places.entry(len(self.manifest.groups) - 1)
        return (entry.stop - entry.start) / self.fps

    def span(self, segment: int) -> tuple[int, int]:
        """Frames [start, stop) of a segment; where its table cannot be had, as if its neighbours were of one length."""
        try:
            found = self.manifest.segments[segment]
        except FormatError:
            return self.manifest.groups.places.guess_span(segment)
        return found.start, found.stop

    def seconds(self, segment: int) -> float:
        """Seconds of play of a segment."""
        start, stop = self.span(segment)
        return (stop - start) / self.fps

    @cached_property
    def quality(self) -> Rows:
        """(S, Q L) PSNR in dB; 0 where it was not measured."""
        return Rows(lambda s: self._measures(s, "psnr", 0.0))

    @cached_property
    def delta_e(self) -> Rows:
        """(S, Q L) mean colour difference CIEDE2000; NaN where it was not measured."""
        return Rows(lambda s: self._measures(s, "delta_e", np.nan))

    def _measures(self, segment: int, name: str, unknown: float) -> NDArray[np.float64]:
        rows = [getattr(level, name) for level in self.manifest.segments[segment].levels]
        return np.array([rows[j][q] if rows[j] else unknown for q, j in self.rungs])

    @cached_property
    def state_bytes(self) -> Rows:
        """(S, L) wire bytes of a state segment; 0 where there is nothing to fetch."""
        levels = range(len(self.manifest.levels))
        return Rows(lambda s: np.array([self._wire(self._state_files(s, j)) for j in levels]))

    def _state_files(self, segment: int, level: int) -> list[str]:
        return self.manifest.state_files(segment, level, self._in_order)

    @cached_property
    def _in_order(self) -> list[int] | None:
        return None if self.tiles is None else sorted(self.tiles)

    @cached_property
    def units(self) -> list[list[int]]:
        """The key units of every level."""
        return [self.manifest.units_of(j, self._in_order) for j in range(len(self.manifest.levels))]

    @cached_property
    def rows(self) -> Rows:
        """(S, Q L) Gaussians that a rung shows: the rows of its key units."""
        return Rows(self._row_counts)

    def _row_counts(self, segment: int) -> NDArray[np.int64]:
        m = self.manifest
        units = m.groups[m.group_of(segment)].units
        return np.array([sum(units[k].count for k in m.units_of(j)) for _, j in self.rungs])

    def allowed(self, segment: int) -> NDArray[np.bool_]:
        """(Q L,) whether the budget has the Gaussians of a rung."""
        return np.asarray(self.rows[segment] <= (np.inf if self.budget is None else self.budget))

    def levels(self, segment: int) -> tuple[Option, ...]:
        """The levels of a segment by the bytes of their states and their quality with the finest keys."""
        sizes, quality = self.state_bytes[segment].tolist(), self.quality[segment]
        return tuple(
            Option(j, size, float(quality[j]), saved)
            for j, (size, saved) in enumerate(zip(sizes, saved_shares(sizes), strict=True))
        )

    @cached_property
    def key_bytes(self) -> Rows:
        """(G, Q, K) wire bytes of a key unit; 0 for one without rows."""
        shape = (len(self.manifest.qualities), self.manifest.units)
        return Rows(
            lambda g: np.array([self._wire(self.manifest.key_files(g, k, q)) for q, k in np.ndindex(*shape)]).reshape(
                shape
            )
        )

    @cached_property
    def bytes_after(self) -> Rows:
        """(S, Q L, Q L) wire bytes of rung c in a segment after rung p in the one before, in the same group."""
        return Rows(lambda s: np.array([self.sizes(s, held, held) for held in self._after]))

    @cached_property
    def _after(self) -> list[KeyUnits]:
        """What is decoded of a group after each rung, at least."""
        return [frozenset((q, unit) for unit in self.units[j]) for q, j in self.rungs]

    def bytes_at_start(self, segment: int, known: Mapping[int, KeyUnits]) -> NDArray[np.int64]:
        """(1 or Q L, Q L) wire bytes of every rung in the first segment of a group, by the rung in the one before.

        That matters where the group keeps rows of the one before, or of the same as that; `known` are keys decoded
        before, in the same loop, by group.
        """
        base = self.manifest.base_of(self.manifest.group_of(segment))
        if base is None:
            return np.asarray(self.bytes_from_scratch[segment])[None]
        held = known.get(base, NONE)
        return np.array([self.sizes(segment, NONE, held | units) for units in self._base_after(segment, base)])

    def _base_after(self, segment: int, base: int) -> list[KeyUnits]:
        """What is decoded of a base after each rung of the segment before; [NONE] where that tells nothing of it."""
        m, before = self.manifest, self.manifest.group_of(segment) - 1
        if base == before:
            return self._after
        if base != m.base_of(before):
            return [NONE]
        kept = {number for number, unit in enumerate(m.groups[before].units) if unit.kept}
        return [frozenset(unit for unit in units if unit[1] in kept) for units in self._after]

    @cached_property
    def bytes_from_scratch(self) -> Rows:
        """(S, Q L) wire bytes of a rung when no key of its group is decoded, nor of one whose rows it keeps."""
        return Rows(lambda s: np.array(self.sizes(s, NONE)))

    def base_bytes(self, group: int) -> NDArray[np.int64]:
        """(Q, K) wire bytes of key units of the group whose rows a group keeps; 0 for one that keeps none."""
        base = self.manifest.base_of(group)
        if base is None:
            return np.zeros((len(self.manifest.qualities), self.manifest.units), np.int64)
        keeps = [unit.kept > 0 for unit in self.manifest.groups[group].units]
        return np.asarray(self.key_bytes[base] * np.array(keeps))

    def sizes(self, segment: int, decoded: KeyUnits, of_base: KeyUnits = NONE) -> list[int]:
        """(Q L,) wire bytes of the keys that are missing and the state.

        `decoded` are units of the segment's group, `of_base` of the group whose rows it keeps. A rung that the budget
        does not allow has OVER_BUDGET bytes.
        """
        m = self.manifest
        group = m.group_of(segment)
        own, base, states = self.key_bytes[group], self.base_bytes(group), self.state_bytes[segment]
        missing = np.where(absent(decoded, own.shape), own, 0) + np.where(absent(of_base, own.shape), base, 0)
        sizes = [int(missing[q, self.units[j]].sum() + states[j]) for q, j in self.rungs]
        return [size if ok else OVER_BUDGET for size, ok in zip(sizes, self.allowed(segment), strict=True)]

    def options(self, segment: int, decoded: KeyUnits, of_base: KeyUnits = NONE) -> tuple[Option, ...]:
        """Every rung of a segment that the budget allows, by number; kept, since sessions ask for few combinations."""
        key = segment, decoded, of_base
        if key not in self._options:
            saved, quality = saved_shares(self.state_bytes[segment]), self.quality[segment]
            sizes = self.sizes(segment, decoded, of_base)
            self._options[key] = tuple(
                Option(r, sizes[r], float(quality[r]), saved[j])
                for r, (_, j) in enumerate(self.rungs)
                if sizes[r] < OVER_BUDGET
            )
        return self._options[key]

    def batch(self, segment: int, rung: int, decoded: KeyUnits, of_base: KeyUnits = NONE) -> Batch:
        """The files that a rung of a segment needs beside the decoded units of its group and of the base.

        They are in the order of units, of every unit those of the group first, then those of the group whose rows it
        keeps.
        """
        m, (q, j) = self.manifest, self.rungs[rung]
        group = m.group_of(segment)
        base, own = m.base_of(group), m.groups[group].units
        files: list[str] = []
        for k in self.units[j]:
            if (q, k) not in decoded:
                files += m.key_files(group, k, q)
            if base is not None and own[k].kept and (q, k) not in of_base:
                files += m.key_files(base, k, q)
        return Batch(tuple(files), tuple(self._state_files(segment, j)))

    def index(self, position: int) -> int:
        """The segment of the package that a session plays at a position."""
        return self.place(position)[1]

    def place(self, position: int) -> tuple[int, int]:
        """(loop, segment) that a session plays at a position."""
        return divmod(self.first + position, self.segments)

    def end(self, loops: int) -> int:
        """How many positions a session has that plays the sequence so often, as far as is known."""
        return loops * self.segments - self.first

    def group(self, position: int) -> tuple[int, int]:
        """(loop, group) that a position belongs to; its keys are fetched once."""
        loop, index = self.place(position)
        return loop, self.manifest.group_of(index)

    def seconds_at(self, position: int) -> float:
        """Seconds of play at a position."""
        return self.seconds(self.index(position))

    def upcoming(self, position: int, count: int, end: int) -> Iterator[tuple[int, bool]]:
        """(segment, whether it begins a group) of the next positions, before `end`, while tables are there."""
        for p in range(position, min(position + count, end)):
            segment = self.index(p)
            if not self._knows(segment):
                return
            yield segment, self.starts_group(segment)

    def _knows(self, segment: int) -> bool:
        """Whether the tables of a segment's group, and of the one whose rows it keeps, can be had."""
        try:
            self.manifest.base_of(self.manifest.group_of(segment))
            return True
        except FormatError:
            return False

    def starts_group(self, segment: int) -> bool:
        """Whether a segment begins a group, so that no key of it is decoded."""
        return segment == self.manifest.segments_of(self.manifest.group_of(segment))[0]

    def loops(self, wanted: int | None = None) -> int:
        """How often the sequence is played: as wanted, else for about SESSION_S; once while it grows."""
        return 1 if self.live else wanted or max(1, round(SESSION_S / self.duration_s))

    def file_bytes(self, path: str) -> int:
        """Bytes of a file without headers."""
        return self.root_bytes if path == JSON_NAME else self.manifest.entry(path).bytes

    def wire_bytes(self, sizes: Sequence[int]) -> int:
        """Bytes of files with their headers."""
        return sum(sizes) + self.header_bytes * len(sizes)

    def _wire(self, paths: list[str]) -> int:
        return self.wire_bytes([self.file_bytes(path) for path in paths])

"""A long programme made of a real package: its groups over and over, each as files of its own, as one catalogue.

Bytes, files and qualities are those of the package, the tables are packed anew. Every viewer asks the tables the same
questions, so that their answers are kept.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import ConfigError
from airgs_codec.package.manifest import Groups, Manifest
from airgs_codec.package.package import Package, root_of
from airgs_codec.package.packing import pack_json
from airgs_codec.package.tables import FileEntry, Group
from airgs_codec.play.catalogue import Catalogue
from airgs_codec.play.units import NONE, KeyUnits

Answer = TypeVar("Answer")
SHARED = (  # tables that all visits of a programme share; each is made when it is first asked for
    "_options", "rungs", "names", "fps", "quality", "delta_e", "state_bytes", "rows", "key_bytes", "bytes_after",
    "_after", "bytes_from_scratch", "units",
)  # fmt: skip


class KnownManifest(Manifest):
    """The same tables, which keep their answers."""

    @staticmethod
    def of(m: Manifest) -> KnownManifest:
        """The tables of `m`."""
        known = KnownManifest(**{part.name: getattr(m, part.name) for part in fields(Manifest)})
        object.__setattr__(known, "_answers", {})
        object.__setattr__(known, "_groups", [m.group_of(segment) for segment in range(len(m.segments))])
        return known

    def _once(self, question: tuple[Any, ...], ask: Callable[[], Answer]) -> Answer:
        answers: dict[tuple[Any, ...], Answer] = self.__dict__["_answers"]
        if question not in answers:
            answers[question] = ask()
        return answers[question]

    def group_of(self, segment: int) -> int:
        """See Manifest."""
        return int(self.__dict__["_groups"][segment])

    def base_of(self, group: int) -> int | None:
        """See Manifest."""
        return self._once(("base", group), lambda: Manifest.base_of(self, group))

    def segments_of(self, group: int) -> range:
        """See Manifest."""
        return self._once(("segments", group), lambda: Manifest.segments_of(self, group))

    def key_files(self, group: int, unit: int, quality: int) -> list[str]:
        """See Manifest."""
        return self._once((group, unit, quality), lambda: Manifest.key_files(self, group, unit, quality))

    def state_files(self, segment: int, level: int, tiles: Iterable[int] | None = None) -> list[str]:
        """See Manifest."""
        chosen = None if tiles is None else tuple(tiles)
        return self._once((segment, level, chosen), lambda: Manifest.state_files(self, segment, level, chosen))

    def entry(self, path: str) -> FileEntry:
        """See Manifest."""
        return self._once((path,), lambda: Manifest.entry(self, path))


def repeat(m: Manifest, times: int) -> Manifest:
    """The tables of a package that shows the groups of `m` so often, each time from files of their own."""
    groups: list[Group] = []
    for turn in range(times):
        shift, before = turn * m.frames, turn * len(m.groups)
        for group in m.groups:
            moved = [replace(s, start=s.start + shift, stop=s.stop + shift) for s in group.segments]
            keeps = None if group.keeps is None else group.keeps + before
            start, stop = group.start + shift, group.stop + shift
            groups.append(replace(group, start=start, stop=stop, segments=moved, keeps=keeps))
    return replace(m, frames=groups[-1].stop, live=False, groups=Groups.of(groups))


@dataclass(eq=False)
class Visit(Catalogue):
    """The part of a programme that a viewer watches: the segments from `first` to `stop`, that one not included."""

    stop: int = 0
    _at_start: dict[tuple[int, KeyUnits], NDArray[np.int64]] = field(default_factory=dict, init=False, repr=False)

    def end(self, loops: int) -> int:
        """Return how many positions the visit has; it is one turn."""
        return self.stop - self.first

    def seconds(self, segment: int) -> float:
        """See Catalogue."""
        return float(self._seconds[segment])

    def place(self, position: int) -> tuple[int, int]:
        """(0, segment) at a position."""
        return 0, self.first + position

    def index(self, position: int) -> int:
        """The segment at a position."""
        return self.first + position

    def group(self, position: int) -> tuple[int, int]:
        """(0, group) of a position."""
        return 0, self.manifest.group_of(self.first + position)

    def limit(self, budget: int | None) -> None:
        """See Catalogue; what copies share stays as it is where the budget does."""
        if budget != self.budget:
            self._at_start = {}
            super().limit(budget)

    def bytes_at_start(self, segment: int, known: Mapping[int, KeyUnits]) -> NDArray[np.int64]:
        """See Catalogue; its answers depend on the keys of one group alone."""
        base = self.manifest.base_of(self.manifest.group_of(segment))
        held = NONE if base is None else known.get(base, NONE)
        if (segment, held) not in self._at_start:
            self._at_start[segment, held] = super().bytes_at_start(segment, {} if base is None else {base: held})
        return self._at_start[segment, held]

    def _knows(self, segment: int) -> bool:
        return True

    def file_bytes(self, path: str) -> int:
        """See Catalogue."""
        if path not in self._file_bytes:
            self._file_bytes[path] = super().file_bytes(path)
        return self._file_bytes[path]

    def prepare(self) -> None:
        """Make what copies share."""
        self._file_bytes: dict[str, int] = {}
        self._seconds = [super(Visit, self).seconds(s) for s in range(self.segments)]
        for name in SHARED:
            getattr(self, name)


class Programme:
    """A package repeated for at least so many seconds. Raises ConfigError where quality was not measured."""

    def __init__(self, package: Package, seconds: float) -> None:
        m = package.manifest
        if not m.measured:
            raise ConfigError("expected a package with measured quality")
        if not (0 < seconds < math.inf):
            raise ConfigError(f"length of the programme: expected more than 0 s, got {seconds:g}")
        long = KnownManifest.of(repeat(m, math.ceil(seconds * float(m.fps) / m.frames)))
        self.whole = Visit(long, root_bytes=len(pack_json(root_of(long))), stop=len(long.segments))
        self.whole.prepare()
        self.starts_s = np.cumsum([0.0, *self.whole._seconds])  # of segments; and the end

    def visit(self, from_s: float, seconds: float) -> Visit:
        """Return what a viewer watches who begins with the segment shown at `from_s`; one segment at least."""
        first = int(np.searchsorted(self.starts_s, from_s, side="right")) - 1
        first = min(max(first, 0), self.whole.stop - 1)
        stop = int(np.searchsorted(self.starts_s, self.starts_s[first] + seconds - 1e-9))
        visit = copy.copy(self.whole)
        visit.first, visit.stop = first, min(max(stop, first + 1), self.whole.stop)
        return visit

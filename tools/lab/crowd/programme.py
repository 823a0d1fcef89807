"""A long programme made of a real package: its groups over and over, each as files of its own.

Bytes, files and qualities are those of the package, the tables are packed anew. Viewers share what is offered.
"""

from __future__ import annotations

import copy
import math
from dataclasses import replace

import numpy as np

from airgs_codec.errors import ConfigError
from airgs_codec.package.manifest import Groups, Manifest
from airgs_codec.package.package import Package, root_of
from airgs_codec.package.parse import pack_json
from airgs_codec.package.tables import Group
from airgs_codec.play.offers import Offers


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


class Visit(Offers):
    """The part of a programme that a viewer watches: the segments from `first` to `stop`, that one not included."""

    stop = 0

    def end(self, loops: int) -> int:
        """Return how many positions the visit has; it is one turn."""
        return self.stop - self.first


class Programme:
    """A package repeated for at least so many seconds. Raises ConfigError where quality was not measured."""

    def __init__(self, package: Package, seconds: float) -> None:
        m = package.manifest
        if not m.measured:
            raise ConfigError("expected a package with measured quality")
        if not (0 < seconds < math.inf):
            raise ConfigError(f"length of the programme: expected more than 0 s, got {seconds:g}")
        long = repeat(m, math.ceil(seconds * float(m.fps) / m.frames))
        self.whole = Visit(long, root_bytes=len(pack_json(root_of(long))))
        self.whole.stop = self.whole.segments
        self.starts_s = np.cumsum(
            [0.0, *map(self.whole.seconds_at, range(self.whole.stop))]
        )  # of segments; and the end

    def visit(self, from_s: float, seconds: float) -> Visit:
        """Return what a viewer watches who begins with the segment shown at `from_s`; one segment at least."""
        first = int(np.searchsorted(self.starts_s, from_s, side="right")) - 1
        first = min(max(first, 0), self.whole.stop - 1)
        stop = int(np.searchsorted(self.starts_s, self.starts_s[first] + seconds - 1e-9))
        visit = copy.copy(self.whole)
        visit.first, visit.stop = first, min(max(stop, first + 1), self.whole.stop)
        return visit

"""What a package offers a player, from numbers alone: policies choose by it without files or tables.

S segments, G groups, T key tiers, Q key qualities, L levels, R rungs, numbered quality by quality.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.play.ladder import Option, saved_shares
from airgs_codec.play.units import NONE, KeyUnits

Numbers = Mapping[str, Any]


class Offer:
    """Stands in for `play.catalogue.Catalogue` where policies look at it. `numbers` are an offer of the vectors."""

    def __init__(self, numbers: Numbers) -> None:
        self._levels: list[Numbers] = numbers["levels"]
        self.groups: list[list[list[int]]] = numbers["groups"]  # G x Q x T wire bytes
        self.segments: list[Numbers] = numbers["segments"]
        of_segments = [s["group"] for s in self.segments]
        self.manifest = SimpleNamespace(
            levels=self._levels, group_of=of_segments.__getitem__, base_of=lambda group: None
        )
        self.rungs = [(q, j) for q in range(len(self.groups[0])) for j in range(len(self._levels))]
        self.quality = np.array([[s["psnr"][j][q] for q, j in self.rungs] for s in self.segments])

    def sizes(self, segment: int, decoded: KeyUnits) -> list[int]:
        """(R,) wire bytes of what is missing where some key units are there."""
        s = self.segments[segment]
        keys = self.groups[s["group"]]
        needed = [[(q, tier) for tier in range(self._levels[j]["tiers"])] for q, j in self.rungs]
        missing = [sum(keys[q][tier] for q, tier in units if (q, tier) not in decoded) for units in needed]
        return [size + s["state_bytes"][j] for size, (_, j) in zip(missing, self.rungs, strict=True)]

    def options(self, segment: int, decoded: KeyUnits) -> tuple[Option, ...]:
        """Every rung of a segment."""
        sizes = self.sizes(segment, decoded)
        quality = self.quality[segment].tolist()
        saved = [level.saved for level in self.levels(segment)]
        return tuple(Option(r, sizes[r], quality[r], saved[j]) for r, (_, j) in enumerate(self.rungs))

    def levels(self, segment: int) -> tuple[Option, ...]:
        """The levels of a segment by the bytes of their states."""
        sizes = self.segments[segment]["state_bytes"]
        rows = zip(sizes, self.quality[segment], saved_shares(sizes), strict=False)
        return tuple(Option(j, size, float(quality), saved) for j, (size, quality, saved) in enumerate(rows))

    @cached_property
    def bytes_from_scratch(self) -> NDArray[np.int64]:
        """(S, R) wire bytes where no key of the group is decoded."""
        return np.array([self.sizes(s, NONE) for s in range(len(self.segments))])

    def bytes_at_start(self, segment: int, known: object) -> NDArray[np.int64]:
        """(1, R) wire bytes at the start of a group; no group keeps rows of another."""
        return self.bytes_from_scratch[segment][None]

    @cached_property
    def bytes_after(self) -> NDArray[np.int64]:
        """(S, R, R) wire bytes of a rung after another one in the segment before, of the same group."""
        held = [frozenset((q, tier) for tier in range(self._levels[j]["tiers"])) for q, j in self.rungs]
        return np.array([[self.sizes(s, decoded) for decoded in held] for s in range(len(self.segments))])

    def seconds(self, segment: int) -> float:
        """Seconds of play of a segment."""
        return float(self.segments[segment]["seconds"])

    def index(self, position: int) -> int:
        """The segment that is played at a position; the sequence is played over and over."""
        return self.place(position)[1]

    def place(self, position: int) -> tuple[int, int]:
        """(loop, segment) that is played at a position."""
        return divmod(position, len(self.segments))

    def seconds_at(self, position: int) -> float:
        """Seconds of play at a position."""
        return self.seconds(self.index(position))

    def upcoming(self, position: int, count: int, end: int) -> Iterator[tuple[int, bool]]:
        """(segment, whether it begins a group) of the next positions, before `end`."""
        for p in range(position, min(position + count, end)):
            yield self.index(p), self.starts_group(self.index(p))

    def starts_group(self, segment: int) -> bool:
        """Whether no key of a segment's group can be decoded before it."""
        return segment == 0 or self.segments[segment]["group"] != self.segments[segment - 1]["group"]

"""What a package offers a viewer, as numbers: wire bytes and qualities of every choice, for players and bounds.

S segments, G groups, T key tiers, Q key qualities, L levels. A rung is a key quality with a level; rungs are numbered
quality by quality. A position is a segment of a session, which may play the sequence several times.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from airgs_codec.package.tables import Manifest
from airgs_codec.play.ladder import Option

SESSION_S = 30.0  # of play
HEADER_BYTES = 350  # HTTP response headers a file
Held = Mapping[int, int]  # key quality -> tiers of it that are at hand, from the first on


@dataclass(frozen=True, eq=False)
class Catalogue:
    """Wire bytes are those of files with `header_bytes` for each."""

    manifest: Manifest
    header_bytes: int = HEADER_BYTES

    @cached_property
    def _options(self) -> dict[tuple[int, tuple[tuple[int, int], ...]], tuple[Option, ...]]:
        return {}

    @cached_property
    def rungs(self) -> list[tuple[int, int]]:
        """(key quality, level) of every rung."""
        return [(q, j) for q in range(len(self.manifest.qualities)) for j in range(len(self.manifest.levels))]

    @cached_property
    def names(self) -> list[str]:
        """Of the rungs."""
        m = self.manifest
        return [f"{m.qualities[q].id}+{m.levels[j].id}" for q, j in self.rungs]

    @cached_property
    def fps(self) -> float:
        """Frames a second."""
        return float(self.manifest.fps)

    @cached_property
    def seconds(self) -> list[float]:
        """(S,) of play."""
        return [(s.stop - s.start) / self.fps for s in self.manifest.segments]

    @cached_property
    def measured(self) -> bool:
        """Whether every rung of every segment has a quality."""
        return all(level.psnr for segment in self.manifest.segments for level in segment.levels)

    @cached_property
    def quality(self) -> NDArray[np.float64]:
        """(S, Q L) PSNR in dB; 0 where it was not measured."""
        table = np.zeros((len(self.manifest.segments), len(self.rungs)))
        for s, segment in enumerate(self.manifest.segments):
            for r, (q, j) in enumerate(self.rungs):
                table[s, r] = segment.levels[j].psnr[q] if segment.levels[j].psnr else 0.0
        return table

    @cached_property
    def state_bytes(self) -> NDArray[np.int64]:
        """(S, L) of a state segment; 0 where there is nothing to fetch."""
        m = self.manifest
        return np.array(
            [[self._wire(m.state_files(s, j)) for j in range(len(m.levels))] for s in range(len(m.segments))]
        )

    @cached_property
    def key_bytes(self) -> NDArray[np.int64]:
        """(G, Q, T) of a key unit; 0 for a tier without rows."""
        m = self.manifest
        shape = (len(m.groups), len(m.qualities), m.tier_count)
        flat = [self._wire(m.key_files(g, t, q)) for g, q, t in np.ndindex(*shape)]
        return np.array(flat).reshape(shape)

    @cached_property
    def bytes_after(self) -> NDArray[np.int64]:
        """(S, Q L, Q L) wire bytes of rung c in a segment after rung p in the one before, in the same group."""
        table = np.empty((len(self.manifest.segments), len(self.rungs), len(self.rungs)), np.int64)
        for s in range(len(table)):
            for p, (quality, level) in enumerate(self.rungs):
                table[s, p] = self.sizes(s, {quality: self.manifest.levels[level].tiers})
        return table

    @cached_property
    def bytes_from_scratch(self) -> NDArray[np.int64]:
        """(S, Q L) wire bytes of a rung with nothing of its group at hand."""
        return np.array([self.sizes(s, {}) for s in range(len(self.manifest.segments))])

    def sizes(self, segment: int, held: Held) -> list[int]:
        """(Q L,) wire bytes of the keys that are missing and the state."""
        m = self.manifest
        group = m.segments[segment].group
        return [
            int(self.key_bytes[group, q, held.get(q, 0) : m.levels[j].tiers].sum() + self.state_bytes[segment, j])
            for q, j in self.rungs
        ]

    def options(self, segment: int, held: Held) -> tuple[Option, ...]:
        """Every rung of a segment, by number; kept, since a session asks for few combinations over and over."""
        key = segment, tuple(sorted(held.items()))
        if key not in self._options:
            levels, quality, sizes = self.manifest.levels, self.quality[segment], self.sizes(segment, held)
            self._options[key] = tuple(
                Option(r, sizes[r], float(quality[r]), levels[j].pruned) for r, (_, j) in enumerate(self.rungs)
            )
        return self._options[key]

    def files(self, segment: int, rung: int, held: Held) -> list[str]:
        """What is fetched for a rung, keys first."""
        m, (q, j) = self.manifest, self.rungs[rung]
        group = m.segments[segment].group
        keys = [path for t in range(held.get(q, 0), m.levels[j].tiers) for path in m.key_files(group, t, q)]
        return keys + m.state_files(segment, j)

    def upcoming(self, position: int, count: int, end: int) -> Iterator[tuple[int, bool]]:
        """(segment, whether it begins a group) of the next positions, before `end`."""
        for p in range(position, min(position + count, end)):
            segment = p % len(self.seconds)
            yield segment, self.starts_group(segment)

    def starts_group(self, segment: int) -> bool:
        """Whether a segment begins a group, so that no key of it is at hand."""
        segments = self.manifest.segments
        return segment == 0 or segments[segment].group != segments[segment - 1].group

    def loops(self, wanted: int | None = None) -> int:
        """How often the sequence is played: as wanted, else for about SESSION_S."""
        return wanted or max(1, round(SESSION_S / sum(self.seconds)))

    def wire_bytes(self, sizes: Sequence[int]) -> int:
        """Bytes of files with their headers."""
        return sum(sizes) + self.header_bytes * len(sizes)

    def _wire(self, paths: list[str]) -> int:
        return self.wire_bytes([self.manifest.files[path].bytes for path in paths])

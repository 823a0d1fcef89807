"""What a package offers a viewer, as numbers: wire bytes and qualities of every choice, for players and bounds.

S segments, G groups, T key tiers, Q key qualities, L levels. A rung is a key quality with a level; rungs are numbered
quality by quality. A position is a segment of a session, which may play the sequence several times.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from airgs_codec.package.store import Package
from airgs_codec.package.tables import JSON_NAME, Manifest, key_init_path, state_init_path
from airgs_codec.play.ladder import Option

SESSION_S = 30.0  # of play
HEADER_BYTES = 350  # HTTP response headers a file
DecodedTiers = Mapping[int, int]  # key quality -> how many of its tiers are decoded, from the first on


@dataclass(frozen=True, slots=True)
class Batch:
    """Paths of the files that are requested together, in the order in which they arrive."""

    init: tuple[str, ...] = ()
    keys: tuple[str, ...] = ()
    state: tuple[str, ...] = ()

    @property
    def files(self) -> tuple[str, ...]:
        """All paths: init segments, key units tier by tier, then the state segment."""
        return self.init + self.keys + self.state

    def without(self, paths: Collection[str]) -> Batch:
        """The batch with those init segments left out that the player has."""
        return Batch(tuple(path for path in self.init if path not in paths), self.keys, self.state)


@dataclass(frozen=True, eq=False)
class Catalogue:
    """What a package offers. Wire bytes are those of files with `header_bytes` for each."""

    manifest: Manifest
    header_bytes: int = HEADER_BYTES
    manifest_bytes: int = 0  # of airgs.json and manifest.mpd together, which count as one file

    @staticmethod
    def of(package: Package) -> Catalogue:
        """The catalogue of an open package."""
        return Catalogue(package.manifest, manifest_bytes=package.manifest_bytes)

    @cached_property
    def _options(self) -> dict[tuple[int, tuple[tuple[int, int], ...]], tuple[Option, ...]]:
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

    @cached_property
    def seconds(self) -> list[float]:
        """(S,) seconds of play of each segment."""
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
    def delta_e(self) -> NDArray[np.float64]:
        """(S, Q L) mean colour difference CIEDE2000; NaN where it was not measured."""
        table = np.full((len(self.manifest.segments), len(self.rungs)), np.nan)
        for s, segment in enumerate(self.manifest.segments):
            for r, (q, j) in enumerate(self.rungs):
                table[s, r] = segment.levels[j].delta_e[q] if segment.levels[j].delta_e else np.nan
        return table

    @cached_property
    def state_bytes(self) -> NDArray[np.int64]:
        """(S, L) wire bytes of a state segment; 0 where there is nothing to fetch."""
        m = self.manifest
        return np.array(
            [[self._wire(m.state_files(s, j)) for j in range(len(m.levels))] for s in range(len(m.segments))]
        )

    @cached_property
    def key_bytes(self) -> NDArray[np.int64]:
        """(G, Q, T) wire bytes of a key unit; 0 for a tier without rows."""
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
        """(S, Q L) wire bytes of a rung when no key of its group is decoded."""
        return np.array([self.sizes(s, {}) for s in range(len(self.manifest.segments))])

    def sizes(self, segment: int, decoded_tiers: DecodedTiers) -> list[int]:
        """(Q L,) wire bytes of the keys that are missing and the state."""
        m = self.manifest
        group = m.segments[segment].group
        return [
            int(
                self.key_bytes[group, q, decoded_tiers.get(q, 0) : m.levels[j].tiers].sum()
                + self.state_bytes[segment, j]
            )
            for q, j in self.rungs
        ]

    def options(self, segment: int, decoded_tiers: DecodedTiers) -> tuple[Option, ...]:
        """Every rung of a segment, by number; kept, since a session asks for few combinations over and over."""
        key = segment, tuple(sorted(decoded_tiers.items()))
        if key not in self._options:
            levels, quality, sizes = self.manifest.levels, self.quality[segment], self.sizes(segment, decoded_tiers)
            self._options[key] = tuple(
                Option(r, sizes[r], float(quality[r]), levels[j].pruned) for r, (_, j) in enumerate(self.rungs)
            )
        return self._options[key]

    def batch(self, segment: int, rung: int, decoded_tiers: DecodedTiers) -> Batch:
        """The files that a rung of a segment needs beside the decoded tiers, with the init segments of each."""
        m, (q, j) = self.manifest, self.rungs[rung]
        group = m.segments[segment].group
        units = [self.key_unit(group, t, q) for t in range(decoded_tiers.get(q, 0), m.levels[j].tiers)]
        state = m.state_files(segment, j)
        init = [path for unit in units for path in unit.init]
        init += [state_init_path(j)] if state and m.state_pictures[j].width else []
        return Batch(tuple(init), tuple(path for unit in units for path in unit.keys), tuple(state))

    def key_unit(self, group: int, tier: int, quality: int) -> Batch:
        """The files of one key unit with its init segment; none for a tier without rows."""
        files = self.manifest.key_files(group, tier, quality)
        has_picture = files and self.manifest.key_pictures[tier][quality].width
        return Batch((key_init_path(tier, quality),) if has_picture else (), tuple(files))

    def index(self, position: int) -> int:
        """The segment of the package that a session plays at a position."""
        return position % len(self.seconds)

    def group(self, position: int) -> tuple[int, int]:
        """(loop, group) that a position belongs to; its keys are fetched once."""
        loop, index = divmod(position, len(self.seconds))
        return loop, self.manifest.segments[index].group

    def seconds_at(self, position: int) -> float:
        """Seconds of play at a position."""
        return self.seconds[position % len(self.seconds)]

    def upcoming(self, position: int, count: int, end: int) -> Iterator[tuple[int, bool]]:
        """(segment, whether it begins a group) of the next positions, before `end`."""
        for p in range(position, min(position + count, end)):
            segment = self.index(p)
            yield segment, self.starts_group(segment)

    def starts_group(self, segment: int) -> bool:
        """Whether a segment begins a group, so that no key of it is decoded."""
        segments = self.manifest.segments
        return segment == 0 or segments[segment].group != segments[segment - 1].group

    def loops(self, wanted: int | None = None) -> int:
        """How often the sequence is played: as wanted, else for about SESSION_S."""
        return wanted or max(1, round(SESSION_S / sum(self.seconds)))

    def file_bytes(self, path: str) -> int:
        """Bytes of a file without headers; airgs.json stands for both manifests."""
        return self.manifest_bytes if path == JSON_NAME else self.manifest.files[path].bytes

    def wire_bytes(self, sizes: Sequence[int]) -> int:
        """Bytes of files with their headers."""
        return sum(sizes) + self.header_bytes * len(sizes)

    def _wire(self, paths: list[str]) -> int:
        return self.wire_bytes([self.manifest.files[path].bytes for path in paths])

"""What a player has of a package beside states: which tables it has read and which key units it has decoded."""

from __future__ import annotations

from dataclasses import dataclass, field

from airgs_codec.package.paths import FileKind, file_kind, group_path, page_path
from airgs_codec.play.catalogue import Batch, Catalogue, DecodedTiers
from airgs_codec.play.events import Arrival


@dataclass(slots=True, eq=False)
class TableStore:
    """Pages of the index and tables of groups are fetched once, also where the sequence is played again."""

    catalogue: Catalogue
    _paths: set[str] = field(default_factory=set)

    def add(self, arrival: Arrival) -> None:
        """Keep what arrived."""
        self._paths.update(path for path in arrival.kept if file_kind(path) is FileKind.MANIFESTS)

    def has(self, position: int) -> bool:
        """Whether the table of the segment at a position is there."""
        return not self.missing(range(position, position + 1))

    def missing(self, positions: range) -> tuple[str, ...]:
        """What these positions still need and can be asked for: pages, and tables that a page or the root leads to."""
        wanted = dict.fromkeys(self._next(self.catalogue.index(position)) for position in positions)
        return tuple(path for path in wanted if path not in self._paths)

    def missing_pages(self) -> tuple[str, ...]:
        """Pages of the index with segments of the session."""
        places = self.catalogue.manifest.groups.places
        first = places.page_of_segment(self.catalogue.first)
        numbers = range(places.pages if first is None else first, places.pages)
        return tuple(path for path in (page_path(n + 1) for n in numbers) if path not in self._paths)

    def _next(self, segment: int) -> str:
        m = self.catalogue.manifest
        page = m.groups.places.page_of_segment(segment)
        if page is not None and page_path(page + 1) not in self._paths:
            return page_path(page + 1)
        return group_path(m.group_of(segment) + 1)


@dataclass(slots=True, eq=False)
class KeyStore:
    """Keys are kept by (loop, group): a group that is played again is fetched again."""

    catalogue: Catalogue
    _tiers: dict[tuple[int, int], dict[int, int]] = field(default_factory=dict)  # key quality -> decoded tiers

    def decoded_tiers(self, position: int) -> DecodedTiers:
        """Key quality -> how many tiers of it are decoded in the group of a position."""
        return self._tiers.get(self.catalogue.group(position), {})

    def missing(self, position: int, rung: int) -> Batch:
        """The files that a rung of the segment at a position still needs."""
        c = self.catalogue
        return c.batch(c.index(position), rung, self.decoded_tiers(position))

    def add(self, arrival: Arrival) -> None:
        """Decode what arrived: a tier counts once its files are there."""
        c, request = self.catalogue, arrival.request
        quality, level = c.rungs[request.rung]
        key = c.group(request.position)
        tiers = self._tiers.setdefault(key, {})
        for tier in range(tiers.get(quality, 0), c.manifest.levels[level].tiers):
            if not set(arrival.kept).issuperset(c.manifest.key_files(key[1], tier, quality)):
                return
            tiers[quality] = tier + 1

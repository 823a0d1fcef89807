"""What a player has of a package beside states: which tables it has read and which key units it has decoded."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from airgs_codec.package.paths import FileKind, file_kind, group_path
from airgs_codec.play.catalogue import Catalogue
from airgs_codec.play.events import Arrival, Batch
from airgs_codec.play.ladder import Option
from airgs_codec.play.units import NONE, KeyUnits


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
        return tuple(path for path in wanted if path is not None)

    def missing_pages(self) -> tuple[str, ...]:
        """Pages of the index with segments of the session."""
        return tuple(self.catalogue.manifest.groups.places.missing_pages(self.catalogue.first, self._paths))

    def _next(self, segment: int) -> str | None:
        """The first missing of what leads to a segment, and then to the group whose rows its group keeps."""
        return next((path for path in self._way(segment) if path not in self._paths), None)

    def _way(self, segment: int) -> Iterator[str]:
        """Pages and tables; each is read when the next is asked for."""
        groups = self.catalogue.manifest.groups
        yield from groups.places.pages_to_segment(segment)
        group = groups.places.at_segment(segment)
        yield group_path(group + 1)
        keeps = groups[group].keeps
        if keeps is not None:
            yield from groups.places.pages_to_group(keeps - 1)
            yield group_path(keeps)


@dataclass(slots=True, eq=False)
class KeyStore:
    """Key units are kept by loop and group: a group that is played again is fetched again."""

    catalogue: Catalogue
    _units: dict[int, dict[int, KeyUnits]] = field(default_factory=dict)  # loop -> group -> units

    def decoded(self, position: int) -> dict[int, KeyUnits]:
        """The units that are decoded of the groups of a position's loop, by group."""
        return dict(self._units.get(self.catalogue.place(position)[0], {}))

    def _of(self, position: int) -> tuple[KeyUnits, KeyUnits]:
        """The units that are decoded of the group of a position, and of the one whose rows it keeps."""
        loop, group = self.catalogue.group(position)
        units, base = self._units.get(loop, {}), self.catalogue.manifest.base_of(group)
        return units.get(group, NONE), NONE if base is None else units.get(base, NONE)

    def shows(self, position: int, rung: int) -> bool:
        """Whether all key units of a rung are decoded for the segment at a position."""
        c, (quality, level) = self.catalogue, self.catalogue.rungs[rung]
        own, of_base = self._of(position)
        units = c.manifest.groups[c.group(position)[1]].units
        return all((quality, k) in own and (not units[k].kept or (quality, k) in of_base) for k in c.units[level])

    def missing(self, position: int, rung: int, tiles: Iterable[int] | None = None) -> Batch:
        """The files that a rung of the segment at a position still needs, of some tiles or of all."""
        c = self._of_tiles(tiles)
        return c.batch(c.index(position), rung, *self._of(position))

    def options(self, position: int, tiles: Iterable[int] | None = None) -> tuple[Option, ...]:
        """Every rung of the segment at a position, with the bytes that it still needs, of some tiles or of all."""
        c = self._of_tiles(tiles)
        return c.options(c.index(position), *self._of(position))

    def _of_tiles(self, tiles: Iterable[int] | None) -> Catalogue:
        return self.catalogue if tiles is None else self.catalogue.of_tiles(tiles)

    def add(self, arrival: Arrival) -> None:
        """Decode what arrived: a unit counts once its files are there."""
        c, request = self.catalogue, arrival.request
        quality, level = c.rungs[request.rung]
        loop, group = c.group(request.position)
        base, arrived = c.manifest.base_of(group), set(arrival.kept)
        units = self._units.setdefault(loop, {})
        for of in (group,) if base is None else (group, base):
            new = {(quality, k) for k in c.units[level] if arrived.issuperset(c.manifest.key_files(of, k, quality))}
            units[of] = units.get(of, NONE) | new

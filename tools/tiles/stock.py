"""What a viewer fetches of one package: bytes on the wire, with headers and tables, as players count them."""

from __future__ import annotations

from dataclasses import dataclass, field

from airgs_codec.package.paths import group_path
from airgs_codec.package.store import Package
from airgs_codec.play.catalogue import NONE, Catalogue, KeyUnits


@dataclass(slots=True, eq=False)
class Stock:
    """A package whose groups are independent, and what was fetched of it. A pass is one time through the sequence."""

    catalogue: Catalogue
    bytes: int = 0
    _tables: set[tuple[int, int]] = field(default_factory=set)  # (pass, group)
    _keys: dict[tuple[int, int], KeyUnits] = field(default_factory=dict)
    _states: set[tuple[int, int, int]] = field(default_factory=set)  # (pass, segment, level)

    @staticmethod
    def of(package: Package) -> Stock:
        """Nothing was fetched but airgs.json."""
        catalogue = Catalogue.of(package)
        return Stock(catalogue, catalogue.wire_bytes([catalogue.root_bytes]))

    def ladder(self) -> list[tuple[int, int]]:
        """(key quality, level) of the rungs in which each level comes with its own keys, the best first."""
        return [(level.quality, j) for j, level in enumerate(self.catalogue.manifest.levels)]

    def fetch(self, turn: int, segment: int, rung: tuple[int, int]) -> None:
        """What a rung of a segment needs that is not there in this pass."""
        c, (quality, level) = self.catalogue, rung
        group = c.manifest.group_of(segment)
        place = turn, group
        if place not in self._tables:
            self._tables.add(place)
            self.bytes += c.wire_bytes([c.file_bytes(group_path(group + 1))])
        if (turn, segment, level) in self._states:
            return
        self._states.add((turn, segment, level))
        held = self._keys.get(place, NONE)
        self.bytes += c.sizes(segment, held)[c.rungs.index(rung)]
        tiers = c.manifest.units_of(level)
        self._keys[place] = held | {(quality, tier) for tier in tiers}

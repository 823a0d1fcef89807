"""Which key units and init segments a player has decoded, and what a rung needs beside them."""

from __future__ import annotations

from dataclasses import dataclass, field

from airgs_codec.package.tables import FileKind, file_kind
from airgs_codec.play.catalogue import Batch, Catalogue, DecodedTiers
from airgs_codec.play.events import Arrival


@dataclass(slots=True, eq=False)
class KeyStore:
    """Keys are kept by (loop, group): a group that is played again is fetched again. Init segments are fetched once."""

    catalogue: Catalogue
    _tiers: dict[tuple[int, int], dict[int, int]] = field(default_factory=dict)  # key quality -> decoded tiers
    _inits: set[str] = field(default_factory=set)

    def decoded_tiers(self, position: int) -> DecodedTiers:
        """Key quality -> how many tiers of it are decoded in the group of a position."""
        return self._tiers.get(self.catalogue.group(position), {})

    def missing(self, position: int, rung: int) -> Batch:
        """The files that a rung of the segment at a position still needs."""
        c = self.catalogue
        return c.batch(c.index(position), rung, self.decoded_tiers(position)).without(self._inits)

    def add(self, arrival: Arrival) -> None:
        """Decode what arrived: a tier counts once its files and its init segment are there."""
        c, request = self.catalogue, arrival.request
        self._inits.update(path for path in arrival.kept if file_kind(path) is FileKind.INIT)
        available = self._inits.union(arrival.kept)
        quality, level = c.rungs[request.rung]
        tiers = self._tiers.setdefault(c.group(request.position), {})
        for tier in range(tiers.get(quality, 0), c.manifest.levels[level].tiers):
            if not available.issuperset(c.key_unit(c.group(request.position)[1], tier, quality).files):
                return
            tiers[quality] = tier + 1

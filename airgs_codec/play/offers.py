"""What a package offers a viewer: for each segment one frozen value, which players, policies, bounds and studies read.

R rungs. A rung is a keyframe quality with a level; rungs are numbered quality by quality. A keyframe is a keyframe tier
of a group in a keyframe quality, which is fetched and decoded once. A position is a segment of a session, which may
play the sequence several times. Wire bytes are those of files with `header_bytes` for each.
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Set as AbstractSet
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import ConfigError, FormatError
from airgs_codec.package.layout import JSON_NAME, group_path
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.package import Package
from airgs_codec.play.ladder import Option, saved_shares

SESSION_S = 30.0  # of play
HEADER_BYTES = 350  # HTTP response headers a file
OVER_BUDGET = 1 << 50  # bytes of a rung that shows too many Gaussians: more than any link carries

Keyframe = tuple[int, int, int]  # group, keyframe quality, keyframe tier
Keyframes = AbstractSet[Keyframe]
NO_KEYFRAMES: Keyframes = frozenset()


@dataclass(frozen=True, slots=True)
class Batch:
    """Paths of the files that are requested together, in the order in which they arrive."""

    keyframes: tuple[str, ...] = ()
    delta: tuple[str, ...] = ()
    tables: tuple[str, ...] = ()  # for what comes next

    @property
    def files(self) -> tuple[str, ...]:
        return self.keyframes + self.delta + self.tables


@dataclass(frozen=True, slots=True)
class KeyframeOffer:
    """A keyframe, or the sound of a group, whose tier is the one behind all keyframe tiers and whose quality is 0."""

    keyframe: Keyframe
    files: tuple[str, ...]  # none where it has no rows
    bytes: int  # on the wire


@dataclass(frozen=True, slots=True)
class RungOffer:
    quality: int  # of the keyframes
    level: int
    psnr: float  # dB; 0 where it was not measured
    delta_e: float  # mean colour difference CIEDE2000; NaN where it was not measured
    gaussians: int  # that a picture shows
    allowed: bool  # whether the budget has as many
    saved: float  # share of the first level's delta that its level saves
    keyframes: tuple[KeyframeOffer, ...]  # sound, then of each keyframe tier that of the group and that of its base
    delta: tuple[str, ...]  # files
    delta_bytes: int  # on the wire


@dataclass(frozen=True, eq=False)
class SegmentOffer:
    segment: int  # in the package
    seconds: float  # of play
    group: int
    base: int | None  # the group from whose keyframes those of the group differ
    starts_group: bool
    rungs: tuple[RungOffer, ...]

    @cached_property
    def psnr(self) -> NDArray[np.float64]:
        return np.array([rung.psnr for rung in self.rungs])

    @cached_property
    def levels(self) -> tuple[Option, ...]:
        return tuple(Option(r.level, r.delta_bytes, r.psnr, r.saved) for r in self.rungs if r.quality == 0)

    def sizes(self, decoded: Keyframes) -> list[int]:
        """Return (R,) wire bytes of deltas and keyframes not yet decoded; OVER_BUDGET if the rung is not allowed."""
        missing = [sum(of.bytes for of in rung.keyframes if of.keyframe not in decoded) for rung in self.rungs]
        both = zip(self.rungs, missing, strict=True)
        return [rung.delta_bytes + size if rung.allowed else OVER_BUDGET for rung, size in both]

    def options(self, decoded: Keyframes) -> tuple[Option, ...]:
        sizes = self.sizes(decoded)
        return tuple(Option(r, sizes[r], o.psnr, o.saved) for r, o in enumerate(self.rungs) if o.allowed)

    def missing(self, rung: int, decoded: Keyframes) -> Batch:
        offer = self.rungs[rung]
        keyframes = tuple(path for of in offer.keyframes if of.keyframe not in decoded for path in of.files)
        return Batch(keyframes, offer.delta)

    def bytes_after(self, before: SegmentOffer, decoded: Keyframes) -> NDArray[np.int64]:
        """Return (R or 1, R) wire bytes of every rung by the rung of the previous segment; one row if it is irrelevant.

        At the start of a group, keyframes that are `decoded` need not be fetched.
        """
        if not self.starts_group:
            return self._within_group
        if self.base is None or self.base not in (before.group, before.base):
            return np.array([self.sizes(decoded)])
        return np.array([self.sizes(decoded | keyframes) for keyframes in before._keyframes])

    @cached_property
    def _keyframes(self) -> list[frozenset[Keyframe]]:
        return [frozenset(offer.keyframe for offer in rung.keyframes) for rung in self.rungs]

    @cached_property
    def _within_group(self) -> NDArray[np.int64]:
        return np.array([self.sizes(keyframes) for keyframes in self._keyframes])


class Offers:
    """Makes the offers of a package, and says which segment a session plays when.

    A session over a growing package (`live`) begins with its newest group and goes on while `grow` is called. Groups
    that came before stay as they are.
    """

    def __init__(
        self, manifest: Manifest, header_bytes: int = HEADER_BYTES, root_bytes: int = 0, live: bool = False
    ) -> None:
        """`root_bytes` are those of airgs.json."""
        self.header_bytes, self.first = header_bytes, 0  # the segment that a session begins with
        self.grow(manifest, root_bytes)
        self.live = live  # more groups may come in this session
        self.offer = lru_cache(4096)(self._offer)

    def __reduce__(self) -> tuple[object, ...]:
        return Offers, (self.manifest, self.header_bytes, self.root_bytes, self.live), {"first": self.first}

    @staticmethod
    def of(package: Package) -> Offers:
        return Offers(package.manifest, root_bytes=package.root_bytes)

    def grow(self, manifest: Manifest, root_bytes: int) -> None:
        """Take the tables of the same package after groups were added."""
        self.manifest, self.root_bytes, self.live = manifest, root_bytes, manifest.live
        self.segments = len(manifest.segments)
        self.fps = float(manifest.fps)

    def _offer(self, segment: int, budget: int | None = None) -> SegmentOffer:
        """Return the offer of a segment, whose rungs are allowed that show no more Gaussians than the budget.

        Raises FormatError where its tables cannot be had.
        """
        m = self.manifest
        group, found = m.group_of(segment), m.segments[segment]
        base, counts = m.base_of(group), [tier.count for tier in m.groups[group].tiers]
        deltas = [tuple(m.delta_files(segment, j)) for j in range(len(m.levels))]
        sizes = [self.wire_bytes(files) for files in deltas]
        saved = saved_shares(sizes)
        sound = [self._keyframe((group, 0, m.tiers), m.sound_files(group))] if m.sound else []
        rungs, groups = [], [group] if base is None else [group, base]
        for q in range(len(m.qualities)):
            keyframes = [self._keyframe((g, q, t), m.keyframe_files(g, t, q)) for t in range(m.tiers) for g in groups]
            for j, level in enumerate(found.levels):
                tiers = m.levels[j].tiers
                rows = sum(counts[:tiers])
                needed = (*sound, *keyframes[: tiers * len(groups)])
                psnr = float(level.psnr[q]) if level.psnr else 0.0
                delta_e = float(level.delta_e[q]) if level.delta_e else np.nan
                allowed = budget is None or rows <= budget
                rungs.append(RungOffer(q, j, psnr, delta_e, rows, allowed, saved[j], needed, deltas[j], sizes[j]))
        starts_group = segment == m.segments_of(group)[0]
        seconds = (found.stop - found.start) / self.fps
        return SegmentOffer(segment, seconds, group, base, starts_group, tuple(rungs))

    def _keyframe(self, keyframe: Keyframe, files: list[str]) -> KeyframeOffer:
        return KeyframeOffer(keyframe, tuple(files), self.wire_bytes(files))

    def sought(self, segment: int, rung: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the tables, then the other files that show a segment to a viewer who has airgs.json alone.

        Raises FormatError where its tables cannot be had.
        """
        offer, places = self.offer(segment), self.manifest.groups.places
        groups = [group for group in (offer.group, offer.base) if group is not None]
        tables = [path for group in groups for path in (*places.pages_to("groups", group), group_path(group + 1))]
        return tuple(dict.fromkeys(tables)), offer.missing(rung, NO_KEYFRAMES).files

    @property
    def rungs(self) -> list[tuple[int, int]]:
        return [(q, j) for q in range(len(self.manifest.qualities)) for j in range(len(self.manifest.levels))]

    @property
    def names(self) -> list[str]:
        m = self.manifest
        return [f"{m.qualities[q].id}+{m.levels[j].id}" for q, j in self.rungs]

    @property
    def duration_s(self) -> float:
        return self.manifest.frames / self.fps

    def span(self, segment: int) -> tuple[int, int]:
        """Return the frames [start, stop) of a segment; a guess from its neighbours where its table is missing."""
        try:
            found = self.manifest.segments[segment]
        except FormatError:
            return self.manifest.groups.places.guess_span(segment)
        return found.start, found.stop

    def seconds_at(self, position: int) -> float:
        start, stop = self.span(self.place(position)[1])
        return (stop - start) / self.fps

    def place(self, position: int) -> tuple[int, int]:
        """Return (loop, segment) that a session plays at a position."""
        return divmod(self.first + position, self.segments)

    def end(self, loops: int) -> int:
        """Return the number of positions in a session of so many loops, as far as is known."""
        return loops * self.segments - self.first

    def loops(self, wanted: int | None = None) -> int:
        """Return how often the sequence is played: as wanted, else for about SESSION_S; once while it grows."""
        seconds = 0 if self.manifest.still else SESSION_S
        return 1 if self.live else wanted or max(1, round(seconds / self.duration_s))

    def check_budget(self, segments: Iterable[int], budget: int | None) -> None:
        """Raise ConfigError where all rungs of one of these segments show more Gaussians than the budget has."""
        if budget is None:
            return
        least = 0
        for segment in segments:
            with suppress(FormatError):  # a table cannot be had
                least = max(least, min(rung.gaussians for rung in self.offer(segment).rungs))
        if least > budget:
            raise ConfigError(f"budget: expected {least} Gaussians or more, got {budget}")

    def file_bytes(self, path: str) -> int:
        return self.root_bytes if path == JSON_NAME else self.manifest.entry(path).bytes

    def wire_bytes(self, paths: Iterable[str]) -> int:
        return sum(self.header_bytes + self.file_bytes(path) for path in paths)

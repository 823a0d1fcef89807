"""A package's tables as one value: the root and its groups, whose tables are read when they are asked for.

Groups, segments, key tiers, qualities and levels are counted from 0; groups and segments in paths from 1.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, overload

from airgs_codec.errors import FormatError
from airgs_codec.package.index import Entry, GroupIndex, ReadPage
from airgs_codec.package.layout import (
    INIT_NAME,
    POSTER_NAME,
    SOUND_INIT_NAME,
    group_path,
    key_media_path,
    key_sidecar_path,
    locate,
    sound_path,
    state_media_path,
)
from airgs_codec.package.parse import build_index, pack_group
from airgs_codec.package.references import check_base
from airgs_codec.package.tables import FileEntry, Group, Header, RungQuality, Segment, Spans

KEPT = 1024  # tables of groups


class Groups(Sequence[Group]):
    """The groups of a package in order. The tables last used stay in memory, the others are read again; one that is
    refused is not, as it is what its digest says.
    """

    def __init__(self, index: list[Spans], read_page: ReadPage, read: Callable[[int, Entry], Group]) -> None:
        self.columns = index
        self.places = GroupIndex(index, read_page)
        self._read = read
        self._kept: OrderedDict[int, Group] = OrderedDict()
        self._refused: dict[int, FormatError] = {}

    @staticmethod
    def of(groups: Sequence[Group]) -> Groups:
        index, pages = build_index(groups, [pack_group(group) for group in groups])
        return Groups(index, partial(_stored, pages), partial(_stored, groups))

    def __len__(self) -> int:
        return self.places.groups

    @overload
    def __getitem__(self, place: int) -> Group: ...

    @overload
    def __getitem__(self, place: slice) -> list[Group]: ...

    def __getitem__(self, place: int | slice) -> Group | list[Group]:
        if isinstance(place, slice):
            return [self[i] for i in range(len(self))[place]]
        number = range(len(self))[place]
        if number in self._refused:
            raise self._refused[number].with_traceback(None)
        if number not in self._kept:
            try:
                self.keep(number, self._read(number, self.places.entry(number)))
            except FormatError as error:
                if error.reason != "missing_file":  # which may come
                    self._refused[number] = error
                raise
        self._kept.move_to_end(number)
        return self._kept[number]

    def keep(self, number: int, group: Group) -> None:
        """Keep a table that is known, counted from 0, so that it need not be read."""
        self._kept[number] = group
        if len(self._kept) > KEPT:
            self._kept.popitem(last=False)


def _stored(tables: Any, which: str | int, _entry: Entry) -> Any:
    return tables[which]


class Segments(Sequence[Segment]):
    """The segments of all groups, one after another."""

    def __init__(self, groups: Groups) -> None:
        self._groups = groups

    def __len__(self) -> int:
        return self._groups.places.segments

    def __getitem__(self, place: int) -> Segment:  # type: ignore[override]  # nobody asks for slices
        number = range(len(self))[place]
        group = self._groups.places.at_segment(number)
        return self._groups[group].segments[number - self._groups.places.entry(group).first_segment]


@dataclass(frozen=True, slots=True)
class Manifest(Header):
    """Everything a decoder needs that is not pixels."""

    init: FileEntry
    groups: Groups

    @property
    def segments(self) -> Segments:
        return Segments(self.groups)

    def group_of(self, segment: int) -> int:
        """The group that a segment belongs to. Raises IndexError."""
        return self.groups.places.at_segment(segment)

    def segments_of(self, group: int) -> range:
        entry = self.groups.places.entry(group)
        return range(entry.first_segment, entry.first_segment + entry.segments)

    def segment_at(self, frame: int) -> int:
        """The segment that shows a frame. Raises IndexError outside the sequence."""
        group = self.groups.places.at_frame(frame)
        stops = [segment.stop for segment in self.groups[group].segments]
        return self.segments_of(group)[next(i for i, stop in enumerate(stops) if frame < stop)]

    def key_files(self, group: int, tier: int, quality: int) -> list[str]:
        """Sidecar and picture of one key tier; no picture of an atlas without rows, nothing of a tier without."""
        entry = self.groups[group].tiers[tier]
        files = [key_sidecar_path(tier, group + 1), key_media_path(tier, quality, group + 1)]
        return files[: (entry.count > 0) + (entry.count > 0 and entry.qualities[quality].rows > 0)]

    def base_of(self, group: int) -> int | None:
        """The group whose rows a group keeps, counted from 0 as well; None where it keeps none.

        Raises FormatError: bad_value where that group is laid out otherwise or keeps some itself, and what reading its
        table raises.
        """
        table = self.groups[group]
        if table.keeps is None:
            return None
        check_base(table, self.groups[table.keeps - 1], group_path(group + 1))
        return table.keeps - 1

    def state_files(self, segment: int, level: int) -> list[str]:
        """The file of one state segment; none where there is nothing to fetch."""
        there = self.segments[segment].levels[level].file.bytes > 0
        return [state_media_path(level, segment + 1)] if there else []

    def sound_files(self, group: int) -> list[str]:
        """The sound of a group; none where there is nothing to fetch."""
        entry = self.groups[group].sound
        return [sound_path(group + 1)] if entry and entry.bytes else []

    def group_files(self, group: int) -> list[str]:
        """Every file that the table of a group lists."""
        tiers, qualities, levels = range(self.tiers), range(len(self.qualities)), range(len(self.levels))
        keys = [path for t in tiers for q in qualities for path in self.key_files(group, t, q)]
        states = [path for s in self.segments_of(group) for j in levels for path in self.state_files(s, j)]
        return sorted({*self.sound_files(group), *keys, *states})

    def shared_files(self) -> list[str]:
        """Files of the whole sequence that are no tables."""
        return [INIT_NAME] + [POSTER_NAME] * (self.poster is not None) + [SOUND_INIT_NAME] * (self.sound is not None)

    def table_files(self) -> Iterator[str]:
        """Pages of the index and tables of the groups."""
        yield from self.groups.places.pages()
        yield from (group_path(number + 1) for number in range(len(self.groups)))

    def files(self) -> Iterator[str]:
        """Every file of the package but airgs.json and manifest.mpd; reads the table of every group."""
        yield from self.shared_files()
        yield from self.table_files()
        for group in range(len(self.groups)):
            yield from self.group_files(group)

    def entry(self, path: str) -> FileEntry:
        """Length and digest of a file. Raises FormatError(missing_entry) for one that the tables do not have."""
        try:
            found = self._entry(path)
        except IndexError:
            found = None
        if found is None or not found.bytes:
            raise FormatError("missing_entry", path, "no table has such a file")
        return found

    def _entry(self, path: str) -> FileEntry | None:
        match locate(path):
            case "sidecar", [tier, number]:
                return self.groups[number - 1].tiers[tier].sidecar
            case "key", [tier, quality, number]:
                return self.groups[number - 1].tiers[tier].pictures[quality]
            case "state", [level, number]:
                return self.segments[number - 1].levels[level].file
            case "sound", [number]:
                return self.groups[number - 1].sound
            case "group", [number]:
                return self.groups.places.entry(number - 1).file
            case "page", [level, number]:
                return self.groups.places.page_file(level, number - 1)
        sound = self.sound.init if self.sound else None
        return {INIT_NAME: self.init, POSTER_NAME: self.poster, SOUND_INIT_NAME: sound}.get(path)

    def bytes_of(self, paths: Iterable[str]) -> int:
        return sum(self.entry(path).bytes for path in paths)

    def media_bytes(self) -> int:
        """Length of all files but the tables and manifest.mpd."""
        return self.bytes_of(self.shared_files()) + sum(
            self.bytes_of(self.group_files(group)) for group in range(len(self.groups))
        )

    def rung_files(self, quality: int, level: int, groups: Sequence[int] | None = None) -> list[str]:
        """Every file a viewer of one rung fetches of some groups, by default of all, without tables."""
        tiers, groups = range(self.levels[level].tiers), range(len(self.groups)) if groups is None else groups
        sound = [path for g in groups for path in self.sound_files(g)]
        keys = [path for g in groups for t in tiers for path in self.key_files(g, t, quality)]
        return sound + keys + [path for g in groups for s in self.segments_of(g) for path in self.state_files(s, level)]


@dataclass(frozen=True, slots=True)
class Rung:
    """Everything that a viewer of one key quality and level fetches from start to end, and what it shows."""

    name: str  # such as Q0+L0
    key_quality: str
    level: str
    bytes: int  # of keys, states, sound and all tables
    psnr: float | None  # dB, of the error pooled over pictures; None: not measured
    best: bool  # whether players choose it, see `on_ladder`


def rungs_of(m: Manifest, manifest_bytes: int) -> tuple[Rung, ...]:
    """The rungs of a package whose tables and manifest.mpd have `manifest_bytes` together, quality by quality."""
    places = [(q, j) for q in range(len(m.qualities)) for j in range(len(m.levels))]
    sizes = [manifest_bytes + m.bytes_of(m.rung_files(q, j)) for q, j in places]
    measured = [quality_of(m, j, q) for q, j in places]
    psnr = [None if one is None else one.psnr for one in measured]
    names = [(m.qualities[q].id, m.levels[j].id) for q, j in places]
    rest = zip(names, sizes, psnr, on_ladder(list(zip(sizes, psnr, strict=True))), strict=True)
    return tuple(Rung("+".join(name), *name, *figures) for name, *figures in rest)  # type: ignore[arg-type]


def quality_of(m: Manifest, level: int, quality: int) -> RungQuality | None:
    """The quality of a rung over the whole package; None where it was not measured."""
    return m.rungs[quality][level] if m.rungs else None


def on_ladder(rungs: Sequence[tuple[float, float | None]]) -> list[bool]:
    """Whether each of some rungs (bytes, PSNR in dB) is on the lower convex hull of mean squared error over bytes.

    A rung above it, such as the finest keys with the coarsest states, is beaten by some mixture of two on it; so is,
    for what is known of it, one that was not measured.
    """
    hull: list[tuple[float, float]] = []  # both ascending
    measured = [(size, psnr) for size, psnr in rungs if psnr is not None]
    for point in sorted(measured, key=lambda p: (p[0], -p[1])):
        if hull and point[1] <= hull[-1][1]:
            continue
        while len(hull) > 1 and _slope(hull[-2], hull[-1]) >= _slope(hull[-2], point):
            hull.pop()
        hull.append(point)
    return [rung in hull for rung in rungs]


def _slope(a: tuple[float, float], b: tuple[float, float]) -> float:
    """Change of the mean squared error for each byte from one point (bytes, PSNR) to a larger one."""
    errors = [10.0 ** (-psnr / 10) for _, psnr in (a, b)]
    return (errors[1] - errors[0]) / (b[0] - a[0])

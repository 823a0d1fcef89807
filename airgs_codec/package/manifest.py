"""A package's tables as one value: the root and its groups, found by its index and read when they are asked for.

Groups, segments, keyframe tiers, qualities and levels are counted from 0; groups and segments in paths from 1.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain, product
from operator import attrgetter
from typing import Literal, overload

from airgs_codec.errors import FormatError
from airgs_codec.package import layout
from airgs_codec.package.layout import group_path, page_path
from airgs_codec.package.parse import check_base, pack_group, pack_json
from airgs_codec.package.tables import (
    NO_FILE,
    PAGE,
    Entry,
    FileEntry,
    Group,
    Header,
    RungQuality,
    Segment,
    Spans,
    file_entry,
)

TABLES_IN_MEMORY = 1024  # of groups
EMPTY = Spans([], [], [], "")
Count = Literal["groups", "frames", "segments"]
Index = tuple[list[Spans], dict[str, Spans]]  # levels in the root, and pages by their paths
ReadPage = Callable[[str, Entry], Spans]  # path and what is said of a page -> the page


def count_groups(index: Sequence[Spans]) -> int:
    return sum(len(spans) * PAGE**level for level, spans in enumerate(index))


def build_index(groups: Sequence[Group], tables: Sequence[bytes]) -> Index:
    """Return the index of groups whose tables are these bytes, and its pages by their paths."""
    index: list[Spans] = []
    pages: dict[str, Spans] = {}
    for number, (group, table) in enumerate(zip(groups, tables, strict=True)):
        index, filled = extend_index(index, number, group, table)
        pages |= filled
    return index, pages


def extend_index(index: Sequence[Spans], number: int, group: Group, table: bytes) -> Index:
    """Return the index with one more group, counted from 0, whose table is these bytes, and the pages that it fills.

    As in a number in base PAGE, a level that would have PAGE entries has none, and the one above has one more: a page.
    """
    frames, segments, file = group.stop - group.start, len(group.segments), file_entry(table)
    pages: dict[str, Spans] = {}
    for level, s in enumerate([*index, EMPTY]):
        full = Spans([*s.frames, frames], [*s.segments, segments], [*s.bytes, file.bytes], s.sha256 + file.sha256)
        if len(full) < PAGE:
            return [*[EMPTY] * level, full, *index[level + 1 :]], pages
        pages[page_path(level + 1, (number + 1) // PAGE ** (level + 1))] = full
        frames, segments, file = sum(full.frames), sum(full.segments), file_entry(pack_json(full))
    raise AssertionError("the level above all others has one entry")


@dataclass(frozen=True, slots=True)
class _Part(Entry):
    """What the index says of a group (level 0), or of those on a page."""

    level: int
    group: int  # the first

    @property
    def path(self) -> str:
        return page_path(self.level, self.group // PAGE**self.level + 1)


def _parts(spans: Spans, level: int, group: int, frame: int, segment: int) -> list[_Part]:
    """Return the parts of a level in the root, or those on a page; the last three are where the first one begins."""
    parts = []
    for place, (frames, segments) in enumerate(zip(spans.frames, spans.segments, strict=True)):
        parts.append(_Part(frame, frame + frames, segment, segments, spans.file(place), level, group))
        group, frame, segment = group + PAGE**level, frame + frames, segment + segments
    return parts


FIRST_OF = {"groups": attrgetter("group"), "frames": attrgetter("start"), "segments": attrgetter("first_segment")}


class GroupIndex:
    """Finds groups by descending from the root. `read_page` gives the page at a path; each is asked for once.

    Methods may raise what `read_page` raises, and IndexError for what is outside the sequence.
    """

    def __init__(self, index: Sequence[Spans], read_page: ReadPage) -> None:
        self._read_page = read_page
        self._pages: dict[str, list[_Part]] = {}
        self._top: list[_Part] = []  # those of the root
        self.groups = self.frames = self.segments = 0
        for level, spans in reversed(list(enumerate(index))):
            self._top += _parts(spans, level, self.groups, self.frames, self.segments)
            self.groups += PAGE**level * len(spans)
            self.frames += sum(spans.frames)
            self.segments += sum(spans.segments)

    def entry(self, group: int) -> Entry:
        return list(self._descend("groups", group))[-1]

    def at_frame(self, frame: int) -> int:
        return list(self._descend("frames", frame))[-1].group

    def at_segment(self, segment: int) -> int:
        return list(self._descend("segments", segment))[-1].group

    def pages(self) -> Iterator[str]:
        """Yield the paths of all pages, those that lead to others first."""
        for level in range(self._top[0].level, 0, -1):
            yield from (page_path(level, number) for number in range(1, self.groups // PAGE**level + 1))

    def sweep(self, parts: Iterable[_Part] | None = None) -> Iterator[int | FormatError]:
        """Yield every group, in order; in place of those that a page leads to that cannot be read, why not."""
        for part in self._top if parts is None else parts:
            if not part.level:
                yield part.group
                continue
            try:
                yield from self.sweep(self._page(part))
            except FormatError as error:
                yield error

    def page_file(self, level: int, number: int) -> FileEntry:
        parts = self._descend("groups", number * PAGE**level)
        return next((part.file for part in parts if part.level == level), NO_FILE)

    def check_page(self, level: int, number: int) -> None:
        next(part for part in self._descend("groups", number * PAGE**level) if part.level < level)

    def pages_to(self, count: Count, number: int) -> Iterator[str]:
        """Yield the pages that lead to a group, frame or segment, from the root on; reads each but the last."""
        return (part.path for part in self._descend(count, number) if part.level)

    def missing_pages(self, segments: range, known: Container[str]) -> list[str]:
        """Return pages with some of these segments that are not known, as far as known pages lead to them."""
        missing, parts = [], [*self._top]
        for part in parts:  # which grows
            own = range(part.first_segment, part.first_segment + part.segments)
            if part.level and own.start < segments.stop and own.stop > segments.start:
                if part.path not in known:
                    missing.append(part.path)
                elif part.level > 1:
                    parts += self._page(part)
        return missing

    def guess_span(self, segment: int) -> tuple[int, int]:
        """Return frames [start, stop) of a segment as if those of its group were of one length, or those of a page that
        cannot be read.
        """
        with suppress(FormatError):
            for part in self._descend("segments", segment):
                found = part
        before, frames = segment - found.first_segment, found.stop - found.start
        return found.start + frames * before // found.segments, found.start + frames * (before + 1) // found.segments

    def _descend(self, count: Count, number: int) -> Iterator[_Part]:
        """Yield the parts that lead to a group, frame or segment, from the root on."""
        total: int = getattr(self, count)
        if not 0 <= number < total:
            raise IndexError(f"{count}: expected 0 to {total - 1}, got {number}")
        parts = self._top
        while True:
            part = parts[bisect_right(parts, number, key=FIRST_OF[count]) - 1]
            yield part
            if not part.level:
                return
            parts = self._page(part)

    def _page(self, part: _Part) -> list[_Part]:
        if part.path not in self._pages:
            page = self._read_page(part.path, part)
            self._pages[part.path] = _parts(page, part.level - 1, part.group, part.start, part.first_segment)
        return self._pages[part.path]


class Groups(Sequence[Group]):
    """The groups of a package in order. The tables last used stay in memory, the others are read again."""

    def __init__(self, index: list[Spans], read_page: ReadPage, read: Callable[[int, Entry], Group]) -> None:
        self.columns = index
        self.places = GroupIndex(index, read_page)
        self._read = read
        self._known: dict[int, Group] = {}  # the last used at the end

    @staticmethod
    def of(groups: Sequence[Group]) -> Groups:
        index, pages = build_index(groups, [pack_group(group) for group in groups])
        return Groups(index, lambda path, _: pages[path], lambda number, _: groups[number])

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
        group = self._known.pop(number, None) or self._read(number, self.places.entry(number))
        self.keep(number, group)
        return group

    def keep(self, number: int, group: Group) -> None:
        self._known[number] = group
        if len(self._known) > TABLES_IN_MEMORY:
            del self._known[next(iter(self._known))]


class Segments(Sequence[Segment]):
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
    groups: Groups

    @property
    def segments(self) -> Segments:
        return Segments(self.groups)

    @property
    def still(self) -> bool:
        return self.frames == 1 and not self.live

    @property
    def length(self) -> str:
        return "1 frame" if self.frames == 1 else f"{self.frames} frames"

    def group_of(self, segment: int) -> int:
        return self.groups.places.at_segment(segment)

    def segments_of(self, group: int) -> range:
        entry = self.groups.places.entry(group)
        return range(entry.first_segment, entry.first_segment + entry.segments)

    def segment_at(self, frame: int) -> int:
        """Return the segment that shows a frame. Raises IndexError outside the sequence."""
        group = self.groups.places.at_frame(frame)
        return self.segments_of(group)[bisect_right(self.groups[group].segments, frame, key=attrgetter("start")) - 1]

    def keyframe_files(self, group: int, tier: int, quality: int) -> list[str]:
        """Return sidecar and picture of a keyframe tier, where it has Gaussians and a picture."""
        entry, files = self.groups[group].tiers[tier], [layout.keyframe_sidecar_path(tier, group + 1)]
        if entry.qualities[quality].rows:
            files.append(layout.keyframe_media_path(tier, quality, group + 1))
        return files if entry.count else []

    def base_of(self, group: int) -> int | None:
        """Return the base of a group, counted from 0 as well, or None. Raises FormatError where it does not fit."""
        table = self.groups[group]
        if table.base is None:
            return None
        check_base(table, self.groups[table.base - 1], group_path(group + 1))
        return table.base - 1

    def delta_files(self, segment: int, level: int) -> list[str]:
        entry = self.segments[segment].levels[level].file
        return [layout.delta_media_path(level, segment + 1)] if entry.bytes else []

    def sound_files(self, group: int) -> list[str]:
        entry = self.groups[group].sound
        return [layout.sound_path(group + 1)] if entry and entry.bytes else []

    def group_files(self, group: int) -> list[str]:
        tiers, qualities, levels = range(self.tiers), range(len(self.qualities)), range(len(self.levels))
        keyframes = [path for t in tiers for q in qualities for path in self.keyframe_files(group, t, q)]
        deltas = [path for s in self.segments_of(group) for j in levels for path in self.delta_files(s, j)]
        return sorted({*self.sound_files(group), *keyframes, *deltas})

    def shared_files(self) -> list[str]:
        return [path for path, entry in self._shared().items() if entry]

    def _shared(self) -> dict[str, FileEntry | None]:
        sound = self.sound.init if self.sound else None
        return {layout.INIT_NAME: self.init, layout.POSTER_NAME: self.poster, layout.SOUND_INIT_NAME: sound}

    def table_files(self) -> Iterator[str]:
        yield from self.groups.places.pages()
        yield from (group_path(number + 1) for number in range(len(self.groups)))

    def files(self) -> Iterator[str]:
        """Return every file of the package but airgs.json and manifest.mpd; reads the table of every group."""
        groups = map(self.group_files, range(len(self.groups)))
        return chain(self.shared_files(), self.table_files(), chain.from_iterable(groups))

    def entry(self, path: str) -> FileEntry:
        """Return length and digest of a file. Raises FormatError(missing_entry) for one that no table has."""
        with suppress(IndexError):
            if (found := self._entry(path)) and found.bytes:
                return found
        raise FormatError("missing_entry", path, "no table has such a file")

    def _entry(self, path: str) -> FileEntry | None:
        match layout.locate(path):
            case "sidecar", [tier, number]:
                return self.groups[number - 1].tiers[tier].sidecar
            case "keyframe", [tier, quality, number]:
                return self.groups[number - 1].tiers[tier].pictures[quality]
            case "delta", [level, number]:
                return self.segments[number - 1].levels[level].file
            case "sound", [number]:
                return self.groups[number - 1].sound
            case "group", [number]:
                return self.groups.places.entry(number - 1).file
            case "page", [level, number]:
                return self.groups.places.page_file(level, number - 1)
        return self._shared().get(path)

    def bytes_of(self, paths: Iterable[str]) -> int:
        return sum(self.entry(path).bytes for path in paths)

    def media_bytes(self) -> int:
        """Return the length of all files but the tables and manifest.mpd."""
        return sum(map(self.bytes_of, [self.shared_files(), *map(self.group_files, range(len(self.groups)))]))

    def rung_files(self, quality: int, level: int, groups: Sequence[int] | None = None) -> list[str]:
        """Return every file that viewers of a rung fetch of some groups, by default of all, without tables."""
        tiers, groups = range(self.levels[level].tiers), range(len(self.groups)) if groups is None else groups
        sound = [path for g in groups for path in self.sound_files(g)]
        keyframes = [path for g in groups for t in tiers for path in self.keyframe_files(g, t, quality)]
        deltas = [path for g in groups for s in self.segments_of(g) for path in self.delta_files(s, level)]
        return sound + keyframes + deltas


@dataclass(frozen=True, slots=True)
class Rung:
    """Everything that a viewer of one keyframe quality and level fetches from start to end, and what it shows."""

    name: str  # such as Q0+L0
    keyframe_quality: str
    level: str
    bytes: int  # of keyframes, deltas, sound and all tables
    psnr: float | None  # dB, of the error pooled over pictures; None: not measured
    best: bool  # whether players choose it, see `on_ladder`


def rungs_of(m: Manifest, manifest_bytes: int) -> tuple[Rung, ...]:
    """Return the rungs of a package whose tables and manifest.mpd have `manifest_bytes`, quality by quality."""
    rungs = []
    for (q, quality), (j, level) in product(enumerate(m.qualities), enumerate(m.levels)):
        size, psnr = manifest_bytes + m.bytes_of(m.rung_files(q, j)), m.rungs[q][j].psnr if m.rungs else None
        rungs.append(Rung(f"{quality.id}+{level.id}", quality.id, level.id, size, psnr, False))
    best = on_ladder([(rung.bytes, rung.psnr) for rung in rungs])
    return tuple(replace(rung, best=chosen) for rung, chosen in zip(rungs, best, strict=True))


def quality_of(m: Manifest, level: int, quality: int) -> RungQuality | None:
    return m.rungs[quality][level] if m.rungs else None


def on_ladder(rungs: Sequence[tuple[float, float | None]]) -> list[bool]:
    """Return whether each of some rungs (bytes, PSNR in dB) is on the lower convex hull of squared error over bytes.

    Some mixture of two on it beats a rung above it, such as the finest keyframes with the coarsest deltas. A rung that
    was not measured is not on it.
    """

    def slope(a: tuple[float, float], b: tuple[float, float]) -> float:
        return float(10.0 ** (-b[1] / 10) - 10.0 ** (-a[1] / 10)) / (b[0] - a[0])

    hull: list[tuple[float, float]] = []  # both ascending
    for point in sorted(((size, psnr) for size, psnr in rungs if psnr is not None), key=lambda p: (p[0], -p[1])):
        if hull and point[1] <= hull[-1][1]:
            continue
        while len(hull) > 1 and slope(hull[-2], hull[-1]) >= slope(hull[-2], point):
            hull.pop()
        hull.append(point)
    return [rung in hull for rung in rungs]

"""A package's tables as one value: the root and its groups, found by its index and read when they are asked for.

Groups, segments, keyframe tiers, qualities and levels are counted from 0; groups and segments in paths from 1.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Literal, overload

from airgs_codec.errors import FormatError
from airgs_codec.package import layout
from airgs_codec.package.layout import group_path, page_path
from airgs_codec.package.parse import check_base, pack_group, pack_json
from airgs_codec.package.tables import PAGE, Entry, FileEntry, Group, Header, RungQuality, Segment, Spans, file_entry

KEPT = 1024  # tables of groups
EMPTY = Spans([], [], [], "")
Count = Literal["groups", "frames", "segments"]
ReadPage = Callable[[str, Entry], Spans]  # path and what is said of a page -> the page


def count_groups(index: Sequence[Spans]) -> int:
    return sum(len(spans) * PAGE**level for level, spans in enumerate(index))


def build_index(groups: Sequence[Group], tables: Sequence[bytes]) -> tuple[list[Spans], dict[str, Spans]]:
    """The index of groups whose tables are these bytes, and its pages by their paths."""
    index: list[Spans] = []
    pages: dict[str, Spans] = {}
    for number, (group, table) in enumerate(zip(groups, tables, strict=True)):
        index, filled = extend_index(index, number, group, table)
        pages |= filled
    return index, pages


def extend_index(
    index: Sequence[Spans], number: int, group: Group, table: bytes
) -> tuple[list[Spans], dict[str, Spans]]:
    """The index with one more group, counted from 0, whose table is these bytes, and the pages that it has filled.

    As with the digits of a number in base PAGE: a level that would have PAGE entries has none, and the one above has
    one more, which is the page that they stand on.
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


class _Block:
    """Parts that follow each other: those of a level in the root, or those on a page. `level` 0: they are groups."""

    def __init__(self, spans: Spans, level: int, group: int, frame: int, segment: int) -> None:
        """The last three are where the first part begins."""
        self.level, self.spans = level, spans
        self.groups = range(group, group + PAGE**level * len(spans), PAGE**level)
        self.frames = list(accumulate(spans.frames, initial=frame))[:-1]
        self.segments = list(accumulate(spans.segments, initial=segment))[:-1]

    def place(self, count: Count, number: int) -> int:
        """The place of the last part that begins at a group, frame or segment or before; -1 where all are later."""
        return bisect_right(getattr(self, count), number) - 1

    def path(self, place: int) -> str:
        return page_path(self.level, self.groups[place] // PAGE**self.level + 1)

    def entry(self, place: int) -> Entry:
        start, spans = self.frames[place], self.spans
        return Entry(start, start + spans.frames[place], self.segments[place], spans.segments[place], spans.file(place))


class GroupIndex:
    """Finds groups by descending from the root. `read_page` gives the page at a path; each is asked for once.

    What is asked for may raise what `read_page` raises, and IndexError for what is outside the sequence.
    """

    def __init__(self, index: Sequence[Spans], read_page: ReadPage) -> None:
        self._read_page = read_page
        self._pages: dict[str, _Block] = {}
        self._top: list[_Block] = []  # those of the root, the last groups first
        self.groups = self.frames = self.segments = 0
        for level in reversed(range(len(index))):
            spans = index[level]
            self._top.insert(0, _Block(spans, level, self.groups, self.frames, self.segments))
            self.groups += PAGE**level * len(spans)
            self.frames += sum(spans.frames)
            self.segments += sum(spans.segments)

    def entry(self, group: int) -> Entry:
        *_, (block, place) = self._descend("groups", group)
        return block.entry(place)

    def at_frame(self, frame: int) -> int:
        *_, (block, place) = self._descend("frames", frame)
        return block.groups[place]

    def at_segment(self, segment: int) -> int:
        *_, (block, place) = self._descend("segments", segment)
        return block.groups[place]

    def pages(self) -> Iterator[str]:
        """The paths of all pages, those that lead to others first."""
        for level in reversed(range(1, len(self._top) + 1)):
            yield from (page_path(level, number) for number in range(1, self.groups // PAGE**level + 1))

    def sweep(self, blocks: Iterable[_Block] | None = None) -> Iterator[int | FormatError]:
        """Every group, in order; in place of those that a page would lead to that cannot be read, why not."""
        for block in reversed(self._top) if blocks is None else blocks:
            for place, group in enumerate(block.groups):
                if not block.level:
                    yield group
                    continue
                try:
                    page = self._page(block, place)
                except FormatError as error:
                    yield error
                else:
                    yield from self.sweep([page])

    def page_file(self, level: int, number: int) -> FileEntry:
        for block, place in self._descend("groups", number * PAGE**level):
            if block.level == level:
                return block.entry(place).file
        raise IndexError(f"page {number} of level {level}: there is none")

    def check_page(self, level: int, number: int) -> None:
        next(block for block, _ in self._descend("groups", number * PAGE**level) if block.level < level)

    def pages_to(self, count: Count, number: int) -> Iterator[str]:
        """The pages that lead to a group, frame or segment, from the root on; each is read when the next is wanted."""
        return (block.path(place) for block, place in self._descend(count, number) if block.level)

    def missing_pages(self, segments: range, there: Container[str]) -> list[str]:
        """Pages with some of these segments that are not there, as far as pages that are there lead to them."""
        missing, blocks = [], [block for block in self._top if block.level]
        while blocks:
            block = blocks.pop()
            for place, first in enumerate(block.segments):
                if first >= segments.stop or first + block.spans.segments[place] <= segments.start:
                    continue
                if block.path(place) not in there:
                    missing.append(block.path(place))
                elif block.level > 1:
                    blocks.append(self._page(block, place))
        return missing

    def guess_span(self, segment: int) -> tuple[int, int]:
        """Frames [start, stop) of a segment as if those of its group were of one length, or those of a page that
        cannot be read.
        """
        with suppress(FormatError):
            for block, place in self._descend("segments", segment):
                entry = block.entry(place)
        before, frames = segment - entry.first_segment, entry.stop - entry.start
        return entry.start + frames * before // entry.segments, entry.start + frames * (before + 1) // entry.segments

    def _descend(self, count: Count, number: int) -> Iterator[tuple[_Block, int]]:
        """The blocks that lead to a group, frame or segment, and the places in them; the first is of the root."""
        total: int = getattr(self, count)
        if not 0 <= number < total:
            raise IndexError(f"{count}: expected 0 to {total - 1}, got {number}")
        block = next(block for block in self._top if block.place(count, number) >= 0)
        while True:
            place = block.place(count, number)
            yield block, place
            if not block.level:
                return
            block = self._page(block, place)

    def _page(self, block: _Block, place: int) -> _Block:
        path, entry = block.path(place), block.entry(place)
        if path not in self._pages:
            page, group = self._read_page(path, entry), block.groups[place]
            self._pages[path] = _Block(page, block.level - 1, group, entry.start, entry.first_segment)
        return self._pages[path]


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
        self._kept[number] = group
        if len(self._kept) > KEPT:
            self._kept.popitem(last=False)


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
    init: FileEntry
    groups: Groups

    @property
    def segments(self) -> Segments:
        return Segments(self.groups)

    def group_of(self, segment: int) -> int:
        return self.groups.places.at_segment(segment)

    def segments_of(self, group: int) -> range:
        entry = self.groups.places.entry(group)
        return range(entry.first_segment, entry.first_segment + entry.segments)

    def segment_at(self, frame: int) -> int:
        """The segment that shows a frame. Raises IndexError outside the sequence."""
        group = self.groups.places.at_frame(frame)
        stops = [segment.stop for segment in self.groups[group].segments]
        return self.segments_of(group)[next(i for i, stop in enumerate(stops) if frame < stop)]

    def keyframe_files(self, group: int, tier: int, quality: int) -> list[str]:
        """Sidecar and picture of one keyframe tier; no picture of an atlas without rows, nothing of a tier without."""
        entry, files = self.groups[group].tiers[tier], [layout.keyframe_sidecar_path(tier, group + 1)]
        if entry.qualities[quality].rows:
            files.append(layout.keyframe_media_path(tier, quality, group + 1))
        return files if entry.count else []

    def base_of(self, group: int) -> int | None:
        """The group whose rows a group keeps, counted from 0 as well; None where it keeps none.

        Raises FormatError: bad_value where that group is laid out otherwise or keeps some itself, and what reading its
        table raises.
        """
        table = self.groups[group]
        if table.base is None:
            return None
        check_base(table, self.groups[table.base - 1], group_path(group + 1))
        return table.base - 1

    def delta_files(self, segment: int, level: int) -> list[str]:
        there = self.segments[segment].levels[level].file.bytes > 0
        return [layout.delta_media_path(level, segment + 1)] if there else []

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
        """Every file of the package but airgs.json and manifest.mpd; reads the table of every group."""
        yield from self.shared_files()
        yield from self.table_files()
        for group in range(len(self.groups)):
            yield from self.group_files(group)

    def entry(self, path: str) -> FileEntry:
        """Length and digest of a file. Raises FormatError(missing_entry) for one that the tables do not have."""
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
        """Length of all files but the tables and manifest.mpd."""
        groups = (self.bytes_of(self.group_files(group)) for group in range(len(self.groups)))
        return self.bytes_of(self.shared_files()) + sum(groups)

    def rung_files(self, quality: int, level: int, groups: Sequence[int] | None = None) -> list[str]:
        """Every file a viewer of one rung fetches of some groups, by default of all, without tables."""
        tiers, groups = range(self.levels[level].tiers), range(len(self.groups)) if groups is None else groups
        sound = [path for g in groups for path in self.sound_files(g)]
        keyframes = [path for g in groups for t in tiers for path in self.keyframe_files(g, t, quality)]
        return (
            sound
            + keyframes
            + [path for g in groups for s in self.segments_of(g) for path in self.delta_files(s, level)]
        )


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
    """The rungs of a package whose tables and manifest.mpd have `manifest_bytes` together, quality by quality."""
    rungs = []
    for q, quality in enumerate(m.qualities):
        for j, level in enumerate(m.levels):
            size, pooled = manifest_bytes + m.bytes_of(m.rung_files(q, j)), quality_of(m, j, q)
            name, psnr = f"{quality.id}+{level.id}", pooled.psnr if pooled else None
            rungs.append(Rung(name, quality.id, level.id, size, psnr, False))
    best = on_ladder([(rung.bytes, rung.psnr) for rung in rungs])
    return tuple(replace(rung, best=chosen) for rung, chosen in zip(rungs, best, strict=True))


def quality_of(m: Manifest, level: int, quality: int) -> RungQuality | None:
    """The quality of a rung over the whole package; None where it was not measured."""
    return m.rungs[quality][level] if m.rungs else None


def on_ladder(rungs: Sequence[tuple[float, float | None]]) -> list[bool]:
    """Whether each of some rungs (bytes, PSNR in dB) is on the lower convex hull of mean squared error over bytes.

    A rung above it, such as the finest keyframes with the coarsest deltas, is beaten by some mixture of two on it; so
    is, for what is known of it, one that was not measured.
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
    errors = [10.0 ** (-psnr / 10) for _, psnr in (a, b)]
    return (errors[1] - errors[0]) / (b[0] - a[0])

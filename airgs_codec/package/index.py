"""The index of a package at work: where a frame, a segment or a group is, reading a page at most once."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Container, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import accumulate, chain
from typing import Literal

from airgs_codec.errors import FormatError
from airgs_codec.package.layout import page_path
from airgs_codec.package.tables import PAGE, FileEntry, Spans


@dataclass(frozen=True, slots=True)
class Entry:
    """What the index says of a group, or of the groups on a page."""

    start: int  # the first frame
    stop: int
    first_segment: int
    segments: int  # how many
    file: FileEntry  # the table of the group, or the page


ReadPage = Callable[[str, Entry], Spans]  # path and what is said of a page -> the page
Count = Literal["groups", "frames", "segments"]


def count_groups(index: Sequence[Spans]) -> int:
    """How many groups an index leads to."""
    return sum(len(spans) * PAGE**level for level, spans in enumerate(index))


@dataclass(frozen=True, slots=True)
class _Block:
    """Parts that follow each other: those of a level in the root, or those on a page."""

    level: int  # of the parts; 0: they are groups, else pages of that level
    spans: Spans
    groups: Sequence[int]  # the first group of each
    frames: Sequence[int]  # the first frame of each
    segments: Sequence[int]  # the first segment of each

    @staticmethod
    def of(spans: Spans, level: int, group: int, frame: int, segment: int) -> _Block:
        """The last three are where the first part begins."""
        size = PAGE**level
        groups = range(group, group + size * len(spans), size)
        return _Block(level, spans, groups, _starts(spans.frames, frame), _starts(spans.segments, segment))

    def place(self, count: Count, number: int) -> int:
        """The place of the last part that begins at a group, frame or segment or before; -1 where all are later."""
        return bisect_right(getattr(self, count), number) - 1

    def path(self, place: int) -> str:
        return page_path(self.level, self.groups[place] // PAGE**self.level + 1)

    def entry(self, place: int) -> Entry:
        """Return what is said of the part at a place."""
        start, spans = self.frames[place], self.spans
        return Entry(start, start + spans.frames[place], self.segments[place], spans.segments[place], spans.file(place))


def _starts(counts: list[int], first: int) -> list[int]:
    return list(accumulate(counts, initial=first))[:-1]


class GroupIndex:
    """Finds groups by descending from the root. `read_page` gives a page; each is asked for once.

    What is asked for may raise what `read_page` raises.
    """

    def __init__(self, index: Sequence[Spans], read_page: ReadPage) -> None:
        self._read_page = read_page
        self._pages: dict[str, _Block] = {}
        self._top: list[_Block] = []  # those of the root, the last groups first
        self.groups = self.frames = self.segments = 0
        for level in reversed(range(len(index))):
            spans = index[level]
            self._top.insert(0, _Block.of(spans, level, self.groups, self.frames, self.segments))
            self.groups += PAGE**level * len(spans)
            self.frames += sum(spans.frames)
            self.segments += sum(spans.segments)

    def entry(self, group: int) -> Entry:
        """Return what is said of a group. Raises IndexError."""
        *_, (block, place) = self._descend("groups", group)
        return block.entry(place)

    def at_frame(self, frame: int) -> int:
        """The group that shows a frame. Raises IndexError outside the sequence."""
        return self._group("frames", frame)

    def at_segment(self, segment: int) -> int:
        """The group that a segment belongs to. Raises IndexError outside the sequence."""
        return self._group("segments", segment)

    def pages(self) -> Iterator[str]:
        """The paths of all pages, those that lead to others first."""
        for level in reversed(range(1, len(self._top) + 1)):
            yield from (page_path(level, number) for number in range(1, self.groups // PAGE**level + 1))

    def sweep(self) -> Iterator[int | FormatError]:
        """Every group, in order; in place of those that a page would lead to that cannot be read, why not."""
        return chain.from_iterable(map(self._sweep, reversed(self._top)))

    def _sweep(self, block: _Block) -> Iterator[int | FormatError]:
        for place, group in enumerate(block.groups):
            if not block.level:
                yield group
                continue
            try:
                page = self._page(block, place)
            except FormatError as error:
                yield error
            else:
                yield from self._sweep(page)

    def page_file(self, level: int, number: int) -> FileEntry:
        """The file of a page, counted from 0 in its level. Raises IndexError."""
        for block, place in self._descend("groups", number * PAGE**level):
            if block.level == level:
                return block.entry(place).file
        raise IndexError(f"page {number} of level {level}: there is none")

    def check_page(self, level: int, number: int) -> None:
        """Read a page, counted from 0 in its level."""
        next(block for block, _ in self._descend("groups", number * PAGE**level) if block.level < level)

    def pages_to(self, count: Count, number: int) -> Iterator[str]:
        """The pages that lead to a group, frame or segment, from the root on; each is read when the next is wanted."""
        return (block.path(place) for block, place in self._descend(count, number) if block.level)

    def missing_pages(self, segments: range, there: Container[str]) -> list[str]:
        """Pages with some of these segments that are not there, as far as pages that are there lead to them."""
        missing, blocks = [], [block for block in self._top if block.level]
        while blocks:
            block = blocks.pop()
            for place in range(len(block.spans)):
                first = block.segments[place]
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

    def _group(self, count: Count, number: int) -> int:
        *_, (block, place) = self._descend(count, number)
        return block.groups[place]

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
        """Return what stands on the page at a place of a block."""
        path = block.path(place)
        if path not in self._pages:
            entry = block.entry(place)
            page = self._read_page(path, entry)
            start = block.groups[place], entry.start, entry.first_segment
            self._pages[path] = _Block.of(page, block.level - 1, *start)
        return self._pages[path]

"""The index of a package at work: where a frame, a segment or a group is, reading a page at most once."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from itertools import accumulate

from airgs_codec.package.tables import PAGE, FileEntry, Index, Spans


@dataclass(frozen=True, slots=True)
class GroupEntry:
    """What the index says of a group."""

    start: int  # its first frame
    stop: int
    first_segment: int
    segments: int  # how many
    file: FileEntry  # its table


@dataclass(frozen=True, slots=True)
class _Block:
    """Groups that follow each other: a page, or those after the last page."""

    spans: Spans
    frames: list[int]  # the first frame of each
    segments: list[int]  # the first segment of each

    @staticmethod
    def of(spans: Spans, frame: int, segment: int) -> _Block:
        return _Block(spans, _starts(spans.frames, frame), _starts(spans.segments, segment))


def _starts(counts: list[int], first: int) -> list[int]:
    return list(accumulate(counts, initial=first))[:-1]


class GroupIndex:
    """Finds groups. `read_page` gives the page of a number that counts from 0; each is asked for once."""

    def __init__(self, index: Index, read_page: Callable[[int], Spans]) -> None:
        self._index, self._read_page = index, read_page
        self._pages = _Block.of(index.pages, 0, 0)
        self._paged_frames, self._paged_segments = sum(index.pages.frames), sum(index.pages.segments)
        self._blocks = {len(index.pages): _Block.of(index.groups, self._paged_frames, self._paged_segments)}
        self.pages = len(index.pages)
        self.groups = PAGE * self.pages + len(index.groups)
        self.frames = self._paged_frames + sum(index.groups.frames)
        self.segments = self._paged_segments + sum(index.groups.segments)

    def entry(self, group: int) -> GroupEntry:
        """What is said of a group. Raises IndexError."""
        if not 0 <= group < self.groups:
            raise IndexError(f"group {group}: there are {self.groups}")
        block, place = self._block(group // PAGE), group % PAGE
        start, spans = block.frames[place], block.spans
        stop = start + spans.frames[place]
        return GroupEntry(start, stop, block.segments[place], spans.segments[place], spans.file(place))

    def page_file(self, number: int) -> FileEntry:
        """The file of a page, counted from 0. Raises IndexError."""
        return self._index.pages.file(range(self.pages)[number])

    def page_of_segment(self, segment: int) -> int | None:
        """The page that says where a segment is; None where the root says it."""
        paged = segment < self._paged_segments
        return bisect_right(self._pages.segments, segment) - 1 if paged else None

    def at_frame(self, frame: int) -> int:
        """The group that shows a frame. Raises IndexError outside the sequence."""
        if not 0 <= frame < self.frames:
            raise IndexError(f"frame {frame}: the sequence has frames 0..{self.frames - 1}")
        number = bisect_right(self._pages.frames, frame) - 1 if frame < self._paged_frames else self.pages
        return PAGE * number + bisect_right(self._block(number).frames, frame) - 1

    def at_segment(self, segment: int) -> int:
        """The group that a segment belongs to. Raises IndexError outside the sequence."""
        if not 0 <= segment < self.segments:
            raise IndexError(f"segment {segment}: there are {self.segments}")
        page = self.page_of_segment(segment)
        number = self.pages if page is None else page
        return PAGE * number + bisect_right(self._block(number).segments, segment) - 1

    def guess_span(self, segment: int) -> tuple[int, int]:
        """Frames [start, stop) of a segment as if those of its group, or of its unread page, were of one length."""
        page = self.page_of_segment(segment)
        if page is not None and page not in self._blocks:
            spans, place, block = self._index.pages, page, self._pages
        else:
            group = self.at_segment(segment)
            block, place = self._block(group // PAGE), group % PAGE
            spans = block.spans
        count, before = spans.segments[place], segment - block.segments[place]
        first, frames = block.frames[place], spans.frames[place]
        return first + frames * before // count, first + frames * (before + 1) // count

    def _block(self, number: int) -> _Block:
        if number not in self._blocks:
            page = self._read_page(number)
            self._blocks[number] = _Block.of(page, self._pages.frames[number], self._pages.segments[number])
        return self._blocks[number]

"""Packages that are no more than numbers, of which vectors tell: from numbers to offers.

T keyframe tiers, Q keyframe qualities, L levels.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import accumulate, pairwise
from types import SimpleNamespace
from typing import Any

from airgs_codec.package import tables as mf
from tests.faces import Groups, Manifest, Offers, build_index, page_path
from tests.support.manifests import HASH, tiny_manifest

Numbers = Mapping[str, Any]
ROWS = 100  # of a tier that are coded, where some are: no player counts them


def manifest_of(numbers: Numbers, count: int | None = None, live: bool = False) -> Manifest:
    """The tables of a package with its first `count` groups."""
    parts = numbers["groups"][:count]
    starts = [0, *accumulate(sum(segment["frames"] for segment in part["segments"]) for part in parts)]
    tables = [_group(part, span) for part, span in zip(parts, pairwise(starts), strict=True)]
    tiny = tiny_manifest()
    return replace(
        tiny,
        sound=mf.Sound(1, 312, _file(50)) if "sound" in parts[0] else None,
        frame_rate=list(numbers["frame_rate"]), frames=starts[-1], live=live, tiers=len(parts[0]["sidecars"]),
        qualities=[replace(tiny.qualities[0], id=name) for name in numbers["qualities"]],
        levels=[replace(tiny.levels[0], **level) for level in numbers["levels"]],
        groups=_groups(tables, [part["table"] for part in parts], numbers["page_bytes"]),
    )  # fmt: skip


def _group(part: Numbers, span: tuple[int, int]) -> mf.Group:
    some = tiny_manifest().groups[0]
    level, tier, atlas = some.segments[0].levels[0], some.tiers[0], some.tiers[0].qualities[0]
    stops = accumulate((segment["frames"] for segment in part["segments"]), initial=span[0])
    segments = []
    for (start, stop), numbers in zip(pairwise(stops), part["segments"], strict=True):
        rows = zip(numbers["bytes"], numbers["psnr"], strict=True)
        segments.append(mf.Segment(start, stop, [replace(level, file=_file(size), psnr=psnr) for size, psnr in rows]))
    tiers = [
        replace(
            tier, count=ROWS * (sidecar > 0), sidecar=_file(sidecar),
            qualities=[replace(atlas, rows=ROWS * (size > 0)) for size in pictures],
            pictures=[_file(size) for size in pictures],
        )
        for sidecar, pictures in zip(part["sidecars"], part["pictures"], strict=True)
    ]  # fmt: skip
    sound = _file(part["sound"]) if "sound" in part else None
    return replace(
        some, start=span[0], stop=span[1], tiers=tiers, segments=segments, base=part.get("base"), sound=sound
    )


def _file(size: int) -> mf.FileEntry:
    return mf.FileEntry(size, HASH) if size else mf.NO_FILE


def _groups(tables: Sequence[mf.Group], table_bytes: Sequence[int], page_bytes: int) -> Groups:
    """Groups of which the index says so; as few as fill no page of the second level."""
    frames = [group.stop - group.start for group in tables]
    segments = [len(group.segments) for group in tables]
    paged = len(tables) // mf.PAGE * mf.PAGE

    def spans(start: int, stop: int) -> mf.Spans:
        sizes = list(table_bytes[start:stop])
        return mf.Spans(frames[start:stop], segments[start:stop], sizes, HASH * len(sizes))

    pages = [spans(start, start + mf.PAGE) for start in range(0, paged, mf.PAGE)]
    columns = [sum(page.frames) for page in pages], [sum(page.segments) for page in pages]
    index = [spans(paged, len(tables)), mf.Spans(*columns, [page_bytes] * len(pages), HASH * len(pages))]
    places = {page_path(1, number): page for number, page in enumerate(pages, 1)}
    return Groups(index[: 1 + bool(pages)], lambda path, _: places[path], lambda number, _: tables[number])


def offers_of(numbers: Numbers) -> Offers:
    return Offers(manifest_of(numbers), numbers["header_bytes"], numbers["root_bytes"])


def growing_offers(numbers: Numbers, steps: Sequence[int]) -> tuple[Offers, Iterator[tuple[Manifest, int]]]:
    """The offers of a package that grows, at the newest of `steps[0]` groups, and what it grows to each time that
    airgs.json is read: so many groups, of which the last step closes the package.
    """
    counts = iter(steps)
    first = manifest_of(numbers, next(counts), live=True)
    offers = Offers(first, numbers["header_bytes"], numbers["root_bytes"], live=True)
    offers.first = first.groups.places.entry(len(first.groups) - 1).first_segment

    def later() -> Iterator[tuple[Manifest, int]]:
        for number, count in enumerate(counts, 2):
            yield manifest_of(numbers, count, live=number < len(steps)), numbers["root_bytes"] + count

    return offers, later()


@cache
def long_index(count: int) -> tuple[list[mf.Spans], dict[str, mf.Spans]]:
    """The index of so many groups of a frame and a segment each, and its pages by their paths."""
    group: Any = SimpleNamespace(start=0, stop=1, segments=[None])
    return build_index([group] * count, [b"table %d" % number for number in range(count)])

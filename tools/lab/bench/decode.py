"""Milliseconds a frame of decoding a package part by part, beside PyAV decoding the same H.264 as anyone would use it.

What is decoded alone is a part of what comes after it: the H.264 of the keys, the keys, the H.264 of the states, the
states, everything in order; then the frame in the middle of the sequence out of a freshly opened package with all key
tiers. "PyAV" opens the MP4 files of the same pictures and decodes them, nothing else. All of the top rung; medians of
all repeats, after one run to warm up.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import av

from airgs_codec.decoder.decode import decode, decode_canonical, decode_frames, decode_segment
from airgs_codec.media.h264 import open_segment
from airgs_codec.package.layout import INIT_NAME
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.package import Package, open_package
from tools.lab import Lab, Page, Row, Section, Table, middle, required, setting, timed


@dataclass(frozen=True, slots=True)
class Options:
    """What is decoded."""

    packages: tuple[Path, ...] = required("packages")
    repeat: int = setting(15, "runs of each part")


def run(options: Options, lab: Lab) -> Page:
    """Every part of every package."""
    return page_of([row for path in options.packages for row in measure(path.name, open_package(path), options.repeat)])


def page_of(rows: list[Row]) -> Page:
    """The page of what was measured."""
    return Page([Section(" ".join(_words(rows)), tables=[Table("decode", rows)])], "Of the top rung.")


def _words(rows: list[Row]) -> Iterator[str]:
    for scene in dict.fromkeys(row["package"] for row in rows):
        ms = {row["part"]: row["ms a frame"] for row in rows if row["package"] == scene}
        yield f"{scene}: {ms['all']:.1f} ms a frame, {ms['all'] / ms['PyAV']:.1f} times what PyAV takes;"
        yield f"one frame alone {ms['one frame']:.1f} ms, {ms['one frame'] / ms['PyAV, for one frame']:.1f} times."


def measure(scene: str, package: Package, repeat: int, only: Sequence[str] = ()) -> list[Row]:
    """A row for each part, or for some."""
    m = package.manifest
    group, size = m.groups[0], m.bytes_of(m.rung_files(0, 0)) / m.frames
    known = {
        "package": scene,
        "Gaussians": group.count,
        "with states": group.levels[0].rows,
        "bytes a frame": size,
    }
    rows = []
    for part, work in ((part, work) for part, work in parts(package).items() if not only or part in only):
        took = middle(timed(work, repeat)).times(1e3 / (1 if "one frame" in part else m.frames))
        rows.append(known | {"part": part, "ms a frame": took.wall, "CPU ms a frame": took.cpu})
    return rows


def parts(package: Package) -> dict[str, Callable[[], None]]:
    """Ways to decode parts of the top rung of a package, all of it, and one frame."""
    m = package.manifest
    bases = [decode_canonical(package, group, 0) for group in range(len(m.groups))]
    index, frame = middle_frame(m)
    alone = [m.group_of(index)], [index], frame - m.segments[index].start + 1

    def key_video() -> None:
        for group, table in enumerate(m.groups):
            for t, tier in enumerate(table.tiers):
                for path in m.key_files(group, t, 0)[1:] if tier.count else []:
                    _decode_video(package, path, tier.qualities[0].pages)

    def state_video() -> None:
        for index in range(len(m.segments)):
            for path in m.state_files(index, 0):
                _decode_video(package, path, m.groups[m.group_of(index)].levels[0].pages)

    def keys() -> None:
        for group in range(len(m.groups)):
            decode_canonical(package, group, 0)

    def states() -> None:
        for index, segment in enumerate(m.segments):
            places = range(segment.stop - segment.start)
            _exhaust(decode_segment(package, index, bases[m.group_of(index)], 0, places))

    return {
        "H.264 of keys": key_video,
        "keys": keys,
        "H.264 of states": state_video,
        "states": states,
        "all": lambda: _exhaust(decode_frames(package, 0, m.frames)),
        "PyAV": lambda: video_alone(package, [*range(len(m.groups))], [*range(len(m.segments))]),
        "one frame": lambda: _exhaust(iter([decode(package, frame)])),
        "PyAV, for one frame": lambda: video_alone(package, *alone),
    }


def middle_frame(m: Manifest) -> tuple[int, int]:
    """The segment in the middle of the sequence, and the frame in the middle of that segment."""
    index = m.segment_at(m.frames // 2)
    return index, (m.segments[index].start + m.segments[index].stop) // 2


def _decode_video(package: Package, path: str, pages: int) -> None:
    _exhaust(iter(open_segment(package.read(path), path, pages)[1]))


def _exhaust(values: Iterator[object]) -> None:
    for _ in values:
        pass


def video_alone(package: Package, groups: list[int], segments: list[int], stop: int | None = None) -> None:
    """Decode the pictures of the top rung by PyAV and nothing else; `stop` pictures of a segment."""
    m = package.manifest
    for g in groups:
        for t, tier in enumerate(m.groups[g].tiers):
            if tier.count:
                _plain_decode(package.read(INIT_NAME) + package.read(m.key_files(g, t, 0)[1]), None)
    for s in segments:
        for media in m.state_files(s, 0):  # where nothing moves there are none
            _plain_decode(package.read(INIT_NAME) + package.read(media), stop)


def _plain_decode(data: bytes, stop: int | None) -> None:
    with av.open(io.BytesIO(data), "r", format="mp4") as container:
        container.streams.video[0].codec_context.thread_count = 1
        for i, _ in enumerate(container.decode(video=0), 1):
            if i == stop:
                break

"""Time to decode a package against PyAV decoding the same H.264 bytes alone, side by side in one run.

    python -m tools.bench_decode PACKAGE [--repeat 15]

`sequence`: all frames in order, a frame; `random`: one frame of a freshly opened package, all key tiers. Medians, ms.
"""

from __future__ import annotations

import argparse
import io
import json
import platform
import statistics
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import av

from airgs_codec.decoder.decode import decode, decode_frames
from airgs_codec.media.h264 import library_versions
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.paths import INIT_NAME
from airgs_codec.package.store import Package, open_package


def plain_decode(data: bytes, stop: int | None) -> None:
    """PyAV as anyone would use it: open the MP4, decode `stop` pictures."""
    with av.open(io.BytesIO(data), "r", format="mp4") as container:
        container.streams.video[0].codec_context.thread_count = 1
        for i, _ in enumerate(container.decode(video=0), 1):
            if i == stop:
                break


def video_alone(package: Package, groups: list[int], segments: list[int], stop: int | None = None) -> None:
    """Decode the pictures of the top rung and nothing else; `stop` pictures of a segment."""
    m = package.manifest
    for g in groups:
        for t, unit in enumerate(m.groups[g].units):
            if unit.count:
                plain_decode(package.read(INIT_NAME) + package.read(m.key_files(g, t, 0)[1]), None)
    for s in segments:
        for media in m.state_files(s, 0):  # where nothing moves there are none
            plain_decode(package.read(INIT_NAME) + package.read(media), stop)


def median_ms(work: Callable[[], object], repeat: int) -> float:
    """Median of `repeat` runs after one to warm up."""
    work()
    times = []
    for _ in range(repeat):
        began = time.perf_counter()
        work()
        times.append(1e3 * (time.perf_counter() - began))
    return statistics.median(times)


def measure(package: Package, repeat: int) -> dict[str, float]:
    """Milliseconds a frame in sequence, and of one frame alone; with the number of that frame."""
    m = package.manifest
    index, frame = middle_frame(m)
    segment = m.segments[index]
    everything = list(range(len(m.groups))), list(range(len(m.segments)))
    alone = [m.group_of(index)], [index], frame - segment.start + 1
    figures = {
        "random_frame": frame,
        "sequence": median_ms(lambda: list(decode_frames(package, 0, m.frames)), repeat) / m.frames,
        "sequence_video_alone": median_ms(lambda: video_alone(package, *everything), repeat) / m.frames,
        "random": median_ms(lambda: decode(package, frame), repeat),
        "random_video_alone": median_ms(lambda: video_alone(package, *alone), repeat),
    }
    for kind in ("sequence", "random"):
        figures[f"{kind}_ratio"] = figures[kind] / figures[f"{kind}_video_alone"]
    return figures


def middle_frame(m: Manifest) -> tuple[int, int]:
    """The segment in the middle of the sequence, and the frame in the middle of that segment."""
    index = m.segment_at(m.frames // 2)
    return index, (m.segments[index].start + m.segments[index].stop) // 2


def main(argv: Sequence[str] | None = None) -> None:
    """Print the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("package", type=Path)
    parser.add_argument("--repeat", type=int, default=15)
    args = parser.parse_args(argv)
    figures = measure(open_package(args.package), args.repeat)
    machine = {"machine": platform.processor() or platform.machine(), "python": platform.python_version()}
    print(json.dumps({**figures, **machine, **library_versions()}, indent=1))


if __name__ == "__main__":
    main()

"""`airgs-encode --follow`: when the frames of a growing sequence end, and what is said of each group."""

from __future__ import annotations

import json
import os
import stat
import sys
import threading
import time
from collections.abc import Callable, Iterable

from airgs_codec.cli.terminal import say, warn
from airgs_codec.encoder.live import PublishedGroup


def frames_may_come(idle_s: float) -> Callable[[int], bool]:
    """Whether further frames may come, given how many are there.

    Where standard input is a pipe, as behind `airgs-train ... |`, until it ends; its lines are passed on to standard
    error. Else until no frame has come for `idle_s` seconds.
    """
    if stat.S_ISFIFO(os.fstat(sys.stdin.fileno()).st_mode):
        return _until_end_of_input()
    return _until_idle(idle_s)


def _until_end_of_input() -> Callable[[int], bool]:
    ended = threading.Event()

    def read() -> None:
        for line in sys.stdin:
            warn(line, end="")
        ended.set()

    threading.Thread(target=read, daemon=True).start()
    return lambda frames: not ended.is_set()


def _until_idle(idle_s: float) -> Callable[[int], bool]:
    seen, since = -1, time.monotonic()

    def more(frames: int) -> bool:
        nonlocal seen, since
        if frames != seen:
            seen, since = frames, time.monotonic()
        return time.monotonic() - since < idle_s

    return more


def report_groups(groups: Iterable[PublishedGroup], target: str, as_json: bool) -> None:
    """Print a line for each group as it is published, and one when the package is closed."""
    count = frames = 0
    for published in groups:
        count, frames = published.number, published.group.stop
        if not as_json:
            say("".join(f"{note}\n" for note in published.notes), end="")
        say(json.dumps(_as_json(published)) if as_json else _as_words(published))
    if not as_json:
        say(f"{target}: {frames} frames in {count} groups, closed")


def _as_json(published: PublishedGroup) -> dict[str, object]:
    group = published.group
    first, last = (round(seconds, 2) for seconds in published.waited_s)
    seconds = {"since_first_frame": first, "since_last_frame": last}
    return {
        "group": published.number,
        "frames": [group.start, group.stop],
        "bytes": _bytes(published),
        "gaussians": group.count,
        "base": group.base,
        **seconds,
        "rows": published.notes,
    }


def _as_words(published: PublishedGroup) -> str:
    group = published.group
    quality = [level.psnr[0] for segment in group.segments for level in segment.levels[:1] if level.psnr]
    shown = f", {min(quality):.1f} dB at least" if quality else ""
    shown += f", keyframe by its difference to group {group.base}" if group.base else ""
    size = _bytes(published) / (group.stop - group.start) / 1e3
    return (
        f"group {published.number}: frames {group.start}-{group.stop - 1}, {size:.1f} kB/frame on the top rung{shown}, "
        f"published {published.waited_s[1]:.1f} s after its last frame"
    )


def _bytes(published: PublishedGroup) -> int:
    group = published.group
    keyframes = sum(tier.sidecar.bytes + tier.pictures[0].bytes for tier in group.tiers)
    return keyframes + sum(segment.levels[0].file.bytes for segment in group.segments)

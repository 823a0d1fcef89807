"""The paper's streaming, frame by frame: frame t is pushed at t / R and should be there at (t + 1) / R.

Keys are not part of it (no link that carries frames at 1 / R carries a key unit in that time, see `select`, case 15);
with `keys`, every frame also carries its share of its group's key. Frames follow one another on the link: one that is
not through when the next is due delays it. A frame none of whose levels fits is skipped under `paper` (nothing is
sent, the last state stands) and sent at whatever level Algorithm 1 names under `paper-literal`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import ConfigError
from airgs_codec.play.catalogue import Catalogue
from airgs_codec.play.ladder import Ladder, Option, frame_budget, select, select_literal
from airgs_codec.play.link import Link
from airgs_codec.play.policies.state import Download, estimate_throughput

MEMORY = 24  # frames that the throughput estimate looks back on
PROBE_BYTES = 1500
SKIPPED = -1  # in place of a level

Chooser = Callable[
    [tuple[Option, ...], float], tuple[int, bool]
]  # levels and budget -> level or SKIPPED, whether it fits


@dataclass(frozen=True, slots=True, eq=False)
class FrameLog:
    """(n,) arrays over the frames of a session."""

    levels: NDArray[np.int64]  # SKIPPED where nothing was sent
    sizes: NDArray[np.float64]  # bytes
    sent_s: NDArray[np.float64]  # from the first bit to the last; 0 for a skipped frame
    waited_s: NDArray[np.float64]  # behind the frames before it
    paper_s: NDArray[np.float64]  # bits over the rate at its moment: the paper's transmission time; inf in an outage
    fits: NDArray[np.bool_]
    quality: NDArray[np.float64]  # dB of the level; NaN where skipped
    fps: float

    @property
    def late(self) -> NDArray[np.bool_]:
        """(n,) frames that missed 1 / R."""
        return self.waited_s + self.sent_s > 1 / self.fps


def frame_options(c: Catalogue, keys: bool) -> list[tuple[Option, ...]]:
    """For each frame of the sequence its levels: H.264 bytes and its share of the sidecar, with `keys` of the key."""
    m = c.manifest
    frames: list[tuple[Option, ...]] = []
    for index, segment in enumerate(m.segments):
        group = m.groups[segment.group]
        count = segment.stop - segment.start
        extra = [0.0] * len(m.levels)
        for j, level in enumerate(m.levels):
            files = m.state_files(index, j)
            extra[j] = m.files[files[1]].bytes / count if files else 0.0
            if keys:
                paths = [p for t in range(level.tiers) for p in m.key_files(segment.group, t, 0)]
                extra[j] += m.bytes_of(paths) / (group.stop - group.start)
        for t in range(count):
            frames.append(
                tuple(
                    Option(
                        j,
                        round((s.frame_bytes[t] if s.frame_bytes else 0) + extra[j]),
                        s.psnr[0] if s.psnr else 0.0,
                        m.levels[j].pruned,
                    )
                    for j, s in enumerate(segment.levels)
                )
            )
    return frames


def choose_best(levels: tuple[Option, ...], budget: float) -> tuple[int, bool]:
    """`paper`: the best level that fits, no level if none does."""
    decision = select(Ladder.build(levels, beta=math.inf, cliff_db=math.inf), budget)
    return (decision.index, True) if decision.fits else (SKIPPED, False)


def choose_literally(levels: tuple[Option, ...], budget: float) -> tuple[int, bool]:
    """`paper-literal`: what Algorithm 1 names, the last level where it names none."""
    answer = select_literal(levels, budget)
    chosen = levels[-1 if answer is None else answer]
    return chosen.index, chosen.size_bytes <= budget


def choose_top(levels: tuple[Option, ...], budget: float) -> tuple[int, bool]:
    """`unpruned`: always level 0."""
    return levels[0].index, levels[0].size_bytes <= budget


def choose_smallest(levels: tuple[Option, ...], budget: float) -> tuple[int, bool]:
    """`pruned`: the smallest level whose frames the ladder keeps, skipped never; the paper's full pruning."""
    smallest = min(levels, key=lambda p: p.size_bytes)
    return smallest.index, smallest.size_bytes <= budget


CHOOSERS: dict[str, Chooser] = {
    "unpruned": choose_top,
    "paper": choose_best,
    "paper-literal": choose_literally,
    "pruned": choose_smallest,
}


def simulate_frames(
    c: Catalogue, link: Link, chooser: str, loops: int, keys: bool = False, known: bool = True
) -> FrameLog:
    """Push `loops` rounds of the sequence. `known`: B is the true rate at the frame's moment, as in the paper, else
    estimated from the frames before.

    Raises ConfigError for a package without measured quality or an unknown chooser.
    """
    if chooser not in CHOOSERS:
        raise ConfigError(f"frame mode: expected {', '.join(CHOOSERS)}, got {chooser}")
    if not c.measured:
        raise ConfigError("frame mode: the package has no measured quality, encode it without --measure-frames 0")
    choose, sequence = CHOOSERS[chooser], frame_options(c, keys)
    history: list[Download] = []
    free = 0.0
    rows: list[tuple[int, float, float, float, float, bool, float]] = []
    for n in range(loops * len(sequence)):
        levels = sequence[n % len(sequence)]
        due = n / c.fps
        rate = link.trace.rate_at(due) if known else estimate_throughput(history[-MEMORY:])
        level, fits = choose(levels, frame_budget(rate, c.fps))
        if level == SKIPPED:
            rows.append((SKIPPED, 0.0, 0.0, 0.0, 0.0, False, math.nan))
            if not known:  # a packet to measure with: an estimate of zero must be able to recover
                begin = max(due, free)
                arrival = link.trace.arrival_s(PROBE_BYTES, begin)
                history.append(Download(PROBE_BYTES, max(arrival - begin, 1e-9)))
            continue
        size = levels[level].size_bytes
        begin = max(due, free)
        free = link.trace.arrival_s(size, begin)
        history.append(Download(max(1, size), max(free - begin, 1e-9)))
        now = link.trace.rate_at(due)
        paper = 8 * size / now if now > 0 else math.inf
        rows.append((level, float(size), free - begin, begin - due, paper, fits, levels[level].quality))
    table = [np.array(column) for column in zip(*rows, strict=True)]
    return FrameLog(table[0], table[1], table[2], table[3], table[4], table[5], table[6], c.fps)


def frame_table(log: FrameLog) -> dict[str, float]:
    """The figures of the paper's table: milliseconds of the frames sent, by the paper's terms and over the link."""
    ms = 1e3 * log.paper_s
    sent = log.levels != SKIPPED
    finite = ms[sent & np.isfinite(ms)]
    on_link = 1e3 * log.sent_s[sent] if sent.any() else np.zeros(1)
    known = log.quality[np.isfinite(log.quality)]
    return {
        "frames": len(ms),
        "kb_frame": float(log.sizes.mean() / 1e3),
        "psnr": float(known.mean()) if len(known) else math.nan,
        "paper_mean_ms": float(finite.mean()) if len(finite) else math.nan,
        "paper_p95_ms": float(np.percentile(finite, 95)) if len(finite) else math.nan,
        "paper_max_ms": float(finite.max()) if len(finite) else math.nan,
        "outage": float((~np.isfinite(ms)).mean()),
        "link_mean_ms": float(on_link.mean()),
        "link_p50_ms": float(np.percentile(on_link, 50)),
        "link_p95_ms": float(np.percentile(on_link, 95)),
        "link_max_ms": float(on_link.max()),
        "late": float(log.late.mean()),
        "infeasible": float((~log.fits).mean()),
        "skipped": float((log.levels == SKIPPED).mean()),
    }

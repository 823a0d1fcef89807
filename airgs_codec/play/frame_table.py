"""The figures of frame mode: the paper's transmission times, what is on the screen, and its integer programme.

What a viewer sees of a frame that was skipped or comes late is the state before it, and how far that is from the
picture that is due nobody measured for a package: it knows the quality of its levels at their own frames alone. So
`psnr` is the mean over the frames sent and stands beside their share; `psnr_screen` counts every frame by the dB that
what stands had at its own frame, which says too much wherever something moves, unless `held` knows better.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from airgs_codec.play.bound import paper_programme
from airgs_codec.play.frame_mode import NOTHING, SKIPPED, FrameLog, Levels
from airgs_codec.play.ladder import frame_budget
from airgs_codec.play.link import Link

PERCENTILES = tuple(range(101))  # of the transmission times: points of their distribution
Held = Callable[[int, int], float]  # number of the frame that stands, of the frame that is due -> dB between them


def frame_table(log: FrameLog, held: Held | None = None) -> dict[str, Any]:
    """The figures of the paper's table: milliseconds of the frames sent, by the paper's terms and over the link.

    `held` gives the dB of an older state against the picture that is due, where that is known. `ms_percentiles` are
    the 0th to 100th percentile of the paper's times over the frames sent outside outages, None where there are none;
    see `figures.FRAME_FIGURES` for the others.
    """
    ms = 1e3 * log.paper_s
    sent = log.levels != SKIPPED
    finite = ms[sent & np.isfinite(ms)]
    on_link = 1e3 * log.sent_s[sent] if sent.any() else np.zeros(1)
    known = log.quality[np.isfinite(log.quality)]
    return {
        "frames": len(ms),
        "kb_frame": float(log.sizes.mean() / 1e3),
        "psnr": float(known.mean()) if len(known) else np.nan,
        **_screen(log, held),
        "paper_mean_ms": float(finite.mean()) if len(finite) else np.nan,
        "paper_p95_ms": float(np.percentile(finite, 95)) if len(finite) else np.nan,
        "paper_max_ms": float(finite.max()) if len(finite) else np.nan,
        "outage": float((~np.isfinite(ms)).mean()),
        "link_mean_ms": float(on_link.mean()),
        "link_p50_ms": float(np.percentile(on_link, 50)),
        "link_p95_ms": float(np.percentile(on_link, 95)),
        "link_max_ms": float(on_link.max()),
        "late": float(log.late.mean()),
        "infeasible": float((~log.fits).mean()),
        "skipped": float((log.levels == SKIPPED).mean()),
        "ms_percentiles": np.percentile(finite, PERCENTILES).round(3).tolist() if len(finite) else None,
    }


def _screen(log: FrameLog, held: Held | None) -> dict[str, float]:
    """The dB of what stands, over the frames at which anything does; shares of frames that show an older one, none."""
    shown, numbers = log.shown, np.arange(len(log.levels))
    old, blank = (shown != NOTHING) & (shown < numbers), shown == NOTHING
    quality = log.quality[shown]
    if held is not None:
        quality[old] = [held(int(shown[n]), int(n)) for n in numbers[old]]
    quality = quality[~blank]
    mean = float(quality.mean()) if len(quality) else np.nan
    return {"psnr_screen": mean, "stale": float(old.mean()), "blank": float(blank.mean())}


def frame_programme(frames: Sequence[Levels], fps: float, link: Link) -> dict[str, float]:
    """The paper's integer programme (eq. 13) over frames pushed at `fps`, with the true rate of each moment as B.

    It separates by frame, so that the best level that fits each frame is as good. Frames of which no level fits are
    left out (`infeasible`): as printed it has no solution there. `psnr` is the mean dB over the others, NaN without
    any; `solve_s` the seconds of the solver.
    """
    budgets = [frame_budget(link.trace.rate_at(n / fps), fps) for n in range(len(frames))]
    sizes = [[level.size_bytes for level in levels] for levels in frames]
    qualities = [[level.quality for level in levels] for levels in frames]
    began_s = time.perf_counter()
    total, feasible = paper_programme(sizes, qualities, budgets)
    solve_s = time.perf_counter() - began_s
    count = int(feasible.sum())
    return {
        "psnr": total / count if count else np.nan,
        "infeasible": 1 - count / len(frames),
        "solve_s": solve_s,
    }

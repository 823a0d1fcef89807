"""What a session was like: figures derived from its log, and the best that could have been shown."""

from __future__ import annotations

import itertools
import math
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from airgs_codec.play.bound import Horizon, Unit, solve_horizon
from airgs_codec.play.player import SHORTEST_S
from airgs_codec.play.policy import STALL_DB
from airgs_codec.play.session import SessionLog


def screen_ticks(log: SessionLog) -> list[tuple[int, int]]:
    """For every display tick (1 / fps) from the first picture on: which entry of `shown`, which frame of it.

    While the player waits, the last frame stays.
    """
    ticks: list[tuple[int, int]] = []
    for i, shown in enumerate(log.shown):
        if i:
            ticks += [(i - 1, log.shown[i - 1].frames - 1)] * round(shown.stall_s * log.catalogue.fps)
        ticks += [(i, frame) for frame in range(shown.frames)]
    return ticks


def metrics(log: SessionLog) -> dict[str, object]:
    """What the session was like. PSNR counts every display tick, frozen ones with the picture that stood.

    Frames of lost segments have no measured quality; they are counted apart and not in PSNR.
    """
    c, shown = log.catalogue, log.shown
    frames = sum(s.frames for s in shown)
    played = frames / c.fps
    stalls = [s.stall_s for s in shown if s.stall_s > SHORTEST_S]
    stall = math.fsum(stalls)
    per_tick = [shown[i].psnr for i, _ in screen_ticks(log)]
    psnr = np.array([p for p in per_tick if p is not None])
    quality = [s.psnr for s in shown if s.psnr is not None]
    changes = [abs(b - a) for a, b in itertools.pairwise(quality)]
    rungs = [s.rung for s in shown]
    wire = sum(f.bytes for f in log.fetches)
    choices = [f for f in log.fetches if f.kind in ("group", "state")]
    end = max(f.arrival_s for f in log.fetches)
    took = frame_times(log)
    return {
        "frames": frames,
        "played_s": played,
        "startup_s": shown[0].start_s,
        "stalls": len(stalls),
        "stall_s": stall,
        "stall_ratio": stall / (played + stall),
        "switches": sum(a != b for a, b in itertools.pairwise(rungs)),
        "psnr_mean": float(psnr.mean()) if len(psnr) else None,
        "psnr_p5": float(np.percentile(psnr, 5)) if len(psnr) else None,
        "change_db": float(np.mean(changes)) if changes else 0.0,
        "qoe": (sum(quality) - sum(changes) - STALL_DB * stall) / len(quality) if quality else None,
        "bytes": dict(log.bytes_by_kind),
        "bytes_per_frame": sum(log.bytes_by_kind.values()) / frames,
        "wire_bytes": wire,
        "wasted": sum(f.wasted for f in log.fetches) / wire,
        "utilisation": wire / max(1.0, log.link.bytes_between(0.0, end)),
        "replaced": sum(f.kind == "better" for f in log.fetches),
        "abandoned": sum("abandoned" in f.reason for f in log.fetches),
        "late": sum(s.stall_s > SHORTEST_S for s in shown) / len(shown),
        "infeasible": sum(not f.fits for f in choices) / max(1, len(choices)),
        "lost_frames": sum(s.frames for s in shown if s.rung is None),
        "frame_ms_mean": float(1e3 * took.mean()) if len(took) else 0.0,
        "frame_ms_p50": float(1e3 * np.percentile(took, 50)) if len(took) else 0.0,
        "frame_ms_p95": float(1e3 * np.percentile(took, 95)) if len(took) else 0.0,
        "frame_ms_max": float(1e3 * took.max()) if len(took) else 0.0,
        "rungs": {"lost" if r is None else c.names[r]: count for r, count in Counter(rungs).most_common()},
        "trace": log.link.trace.name,
        "trace_mean_bps": log.link.trace.mean_bps,
        "trace_scale": log.link.trace.scale,
        "trace_offset_s": log.link.trace.offset_s,
        "trace_end": log.link.trace.end,
        "trace_ended": end > log.link.trace.duration_s,
        "rtt_s": log.link.rtt_s,
    }


def frame_times(log: SessionLog) -> NDArray[np.float64]:
    """Seconds that every frame shown was on its way: its share of the batch that brought it."""
    took = {f.position: f.arrival_s - f.request_s for f in log.fetches if f.kind != "manifests"}
    frames = [log.shown[p].frames for p in took]
    return np.repeat([t / n for t, n in zip(took.values(), frames, strict=True)], frames)


def session_bound(log: SessionLog, integer: bool = False) -> float | None:
    """dB: no player could have shown better at the same moments, see `optimum`. None when segments were lost."""
    units = []
    manifest_s = log.fetches[0].arrival_s
    c, link, limit = log.catalogue, log.link, log.settings.buffer_s
    fronts = np.cumsum([0.0, *(s.frames / c.fps for s in log.shown)])  # media time at which each begins
    for k, shown in enumerate(log.shown):
        if shown.rung is None:
            return None
        release = manifest_s
        wanted = float(fronts[k + 1]) - limit  # media that must have been shown before the request
        if wanted > 0:
            i = int(np.searchsorted(fronts, wanted - SHORTEST_S)) - 1  # before a stall, if one follows just there
            release = max(release, log.shown[i].start_s + wanted - float(fronts[i]))
        begin, deadline = release + link.rtt_s, shown.start_s - log.settings.decode_frame_s
        capacities = link.bytes_between(0.0, begin), link.bytes_between(0.0, deadline)
        units.append(Unit(shown.segment, c.starts_group(shown.segment), *capacities))
    plan = solve_horizon(Horizon(c, tuple(units), {}), integer)
    return None if plan is None else plan.quality


def mean_quality(log: SessionLog) -> float:
    """dB over media time, as `session_bound` counts it."""
    known = [(s.psnr, s.frames) for s in log.shown if s.psnr is not None]
    return sum(p * n for p, n in known) / sum(n for _, n in known)

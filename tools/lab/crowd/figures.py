"""Figures of crowds: what every policy's viewers got, what the edge and the origin sent, hit rates by cache size."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from tools.lab.crowd.edge import replay
from tools.lab.crowd.simulation import Outcome
from tools.lab.crowd.viewer import Seen
from tools.lab.page import Row

ALL = "all"  # in place of a policy: the viewers of all policies together
BUSY_S = 5  # the busiest so many seconds say what a crowd wants


def jain(values: ArrayLike) -> float:
    """Jain's fairness index, (sum x)^2 / (n sum x^2): 1 where all have the same, 1/n where one has everything."""
    x = np.asarray(values, np.float64)
    squares = float((x**2).sum())
    return float(x.sum()) ** 2 / (len(x) * squares) if squares > 0 else 1.0


def busiest_bps(outcome: Outcome) -> float:
    """The most bit/s that the shared link carried over BUSY_S seconds."""
    egress = np.array([second.egress_bytes for second in outcome.seconds])
    wide = min(BUSY_S, len(egress))
    return 8 * float(np.convolve(egress, np.ones(wide), "valid").max()) / wide


def viewer_row(seen: Sequence[Seen]) -> Row:
    """Figures of some viewers together.

    `stall_s_hour` is waiting after the first picture for an hour of play and waiting. PSNR is the mean over a viewer's
    display ticks of dB; `psnr_low` is the 5th percentile over viewers of that mean, `psnr_p5` the mean over viewers of
    the 5th percentile over ticks. Bit rates are those of everything on the wire for a second of media.
    """
    played, stalled = (np.array([getattr(s, name) for s in seen]) for name in ("played_s", "stall_s"))
    startup, psnr = (np.array([getattr(s, name) for s in seen]) for name in ("startup_s", "psnr_mean"))
    bitrate = np.array([s.bitrate_bps for s in seen])
    return {
        "viewers": len(seen),
        "stalled_share": float(np.mean([s.stalls > 0 for s in seen])),
        "stall_s_hour": 3600 * float(stalled.sum() / (stalled.sum() + played.sum())),
        "startup_p50_s": float(np.percentile(startup, 50)),
        "startup_p95_s": float(np.percentile(startup, 95)),
        "startup_p99_s": float(np.percentile(startup, 99)),
        "psnr": float(psnr.mean()),
        "psnr_low": float(np.percentile(psnr, 5)),
        "psnr_p5": float(np.mean([s.psnr_p5 for s in seen])),
        "mbps": float(bitrate.mean() / 1e6),
        "jain_psnr": jain(psnr),
        "jain_bitrate": jain(bitrate),
        "requests_s": sum(s.requests for s in seen) / sum(s.session_s for s in seen),
        "replaced": sum(s.replaced for s in seen),
        "abandoned": sum(s.abandoned for s in seen),
    }


def policy_rows(outcome: Outcome) -> list[Row]:
    """A row a policy, and one of all viewers where there are several policies."""
    names = outcome.settings.policies
    rows = [{"policy": n} | viewer_row([s for s in outcome.seen if s.policy == n]) for n in names]
    return rows + ([{"policy": ALL} | viewer_row(outcome.seen)] if len(names) > 1 else [])


def edge_row(outcome: Outcome) -> Row:
    """What the edge and the origin sent. Rates are those of the BUSY_S seconds in which the shared link was fullest."""
    tally, seconds = outcome.edge.tally, outcome.seconds
    egress = np.array([second.egress_bytes for second in seconds])
    wide = min(BUSY_S, len(seconds))
    first = int(np.argmax(np.convolve(egress, np.ones(wide), "valid")))
    busy = seconds[first : first + wide]
    return {
        "requests": tally.requests,
        "hits": tally.hits,
        "joined": tally.joined,
        "checks": tally.checks,
        "origin_requests": tally.origin_requests,
        "request_hit_rate": tally.request_hit_rate,
        "byte_hit_rate": tally.byte_hit_rate,
        "edge_gb": outcome.passed_bytes / 1e9,
        "origin_gb": tally.origin_bytes / 1e9,
        "files": len(outcome.edge.sizes),
        "files_mb": sum(outcome.edge.sizes) / 1e6,
        "busy_viewers": max(second.viewers for second in busy),
        "busy_edge_mbps": 8e-6 * sum(second.egress_bytes for second in busy) / wide,
        "busy_origin_mbps": 8e-6 * sum(second.origin_bytes for second in busy) / wide,
        "busy_requests_s": sum(second.requests for second in busy) / wide,
    }


def cache_rows(outcome: Outcome, capacities_mb: Sequence[float]) -> list[Row]:
    """Hit rates of other caches for the same requests in the same order; airgs.json, which is not cached, left out."""
    log, sizes = np.frombuffer(outcome.edge.log, np.int32), np.array(outcome.edge.sizes, np.int64)
    asked, rows = int(sizes[log].sum()), []
    for capacity_mb in capacities_mb:
        misses, missed = replay(log, sizes, 1e6 * capacity_mb)
        hit = {"request_hit_rate": 1 - misses / len(log), "byte_hit_rate": 1 - int(missed) / asked}
        rows.append({"cache_mb": capacity_mb, **hit, "origin_gb": int(missed) / 1e9})
    return rows

"""The paper's server for one viewer, as a reference for the stateless package.

It keeps D'_t, what this viewer has, and sends d'_t = p(D_t - D'_{t-1}) in whole steps: p keeps the rows with the
highest usage, the pruned share is chosen for every frame so that the frame fits B / R. Bytes are those of an adaptive
range coder over the kept rows' changes (see `rangecoder`); which rows those are follows from usage, which the viewer
knows. D_t is the top rung of a package rounded to its steps. The viewer adds what arrives: GS_t = GC_k + sum d'_t.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.rangecoder import encode_columns
from airgs_codec.decoder.group_states import SHARES, GroupStates, kept_rows, load_states, score_rows
from airgs_codec.media.metrics import mse, psnr
from airgs_codec.package.store import Package
from airgs_codec.play.ladder import frame_budget
from airgs_codec.play.link import Link
from airgs_codec.progress import Progress, silent
from airgs_codec.render import Camera, render


@dataclass(frozen=True, slots=True)
class Sent:
    """One frame."""

    frame: int  # in the package
    pruned: float
    bytes: int
    budget: float
    stale: float  # rows whose D' is not D, of those that move
    drift: int  # largest difference between what the viewer has and D'_t, in steps
    mse: float  # against the top rung, mean over the views


class Server:
    """State of one viewer in one group."""

    def __init__(self, states: GroupStates, score: NDArray[np.float64]) -> None:
        self.states = states
        scaled = states.values / states.steps[:, None].astype(np.float32)
        self.wanted = np.rint(scaled).astype(np.int32)  # (T, 10 + C, n) D_t in steps
        self.sent = np.zeros_like(self.wanted[0])  # D'_t
        self._kept = {share: kept_rows(score, share) for share in SHARES}

    def change(self, frame: int, share: float) -> NDArray[np.int32]:
        """(10 + C, n) d'_t for a pruned share, zeros in withheld rows."""
        return np.where(self._kept[share], self.wanted[frame] - self.sent, 0)

    def size(self, frame: int, share: float) -> int:
        """Bytes of it."""
        if share == 1:
            return 0
        kept = (self.wanted[frame] - self.sent)[:, self._kept[share]].astype(np.int64)
        used = np.flatnonzero(kept.any(axis=1))  # channels that change; which, is a bit each
        zigzag = (kept[used] << 1) ^ (kept[used] >> 63)
        return len(encode_columns([(column, 1) for column in zigzag])) + -(-len(kept) // 8)

    def fit(self, frame: int, budget: float) -> float:
        """The least pruned share whose bytes fit, by bisection as in Algorithm 1 (sizes fall with the share)."""
        low, high = 0, len(SHARES) - 1
        while low < high:
            middle = (low + high) // 2
            if self.size(frame, SHARES[middle]) <= budget:
                high = middle
            else:
                low = middle + 1
        return SHARES[low]


def run_closed_loop(
    package: Package,
    training: Sequence[Camera],
    views: Sequence[Camera],
    choose: Callable[[Server, int, float], float],
    link: Link | None = None,
    loops: int = 1,
    measure: str = "hits",
    progress: Progress = silent,
) -> list[Sent]:
    """Serve the package's sequence `loops` times. `choose(server, frame of the group, budget)` gives the pruned share.

    Budgets are B / R at the frame's moment of the link's trace, without a link unlimited. Rows are ranked by
    `measure` (the paper's: hits). Every frame of the first round is rendered from `views`.
    """
    m = package.manifest
    groups = [load_states(package, g) for g in range(len(m.groups))]
    scores = [score_rows(states, list(training))[measure] for states in groups]
    fps = float(m.fps)
    out: list[Sent] = []
    for number in range(loops * m.frames):
        progress("frames", number, loops * m.frames)
        frame = number % m.frames
        g = next(i for i, group in enumerate(m.groups) if group.start <= frame < group.stop)
        t = frame - m.groups[g].start
        if t == 0:
            server = Server(groups[g], scores[g])
            viewer = np.zeros_like(server.sent)
        budget = frame_budget(link.trace.rate_at(number / fps), fps) if link else np.inf
        share = choose(server, t, budget)
        size = server.size(t, share)
        change = server.change(t, share)
        server.sent = server.sent + change
        viewer += change
        squared = _error(server, t, views) if number < m.frames else np.nan
        stale = float((server.sent != server.wanted[t]).any(axis=0).mean()) if server.sent.size else 0.0
        drift = int(np.abs(viewer - server.sent).max(initial=0))
        out.append(Sent(frame, share, size, budget, stale, drift, squared))
    return out


def _error(server: Server, t: int, views: Sequence[Camera]) -> float:
    states = server.states
    steps = states.steps[:, None].astype(np.float32)
    shown = states.show(server.sent.astype(np.float32) * steps)
    top = states.show(states.values[t])
    return float(np.mean([mse(render(shown, camera).rgb, render(top, camera).rgb) for camera in views]))


def adaptive(server: Server, t: int, budget: float) -> float:
    """The paper's choice."""
    return server.fit(t, budget)


def always(share: float) -> Callable[[Server, int, float], float]:
    """One pruned share for every frame."""
    return lambda server, t, budget: share


def closed_loop_table(sent: Sequence[Sent]) -> dict[str, float]:
    """Means over frames; PSNR of the mean error against the package's top rung."""
    measured = np.array([s.mse for s in sent])
    measured = measured[np.isfinite(measured)]
    return {
        "frames": len(sent),
        "kb_frame": float(np.mean([s.bytes for s in sent]) / 1e3),
        "worst_kb": max(s.bytes for s in sent) / 1e3,
        "pruned": float(np.mean([s.pruned for s in sent])),
        "skipped": float(np.mean([s.pruned == 1 for s in sent])),
        "stale": float(np.mean([s.stale for s in sent])),
        "drift_steps": max(s.drift for s in sent),
        "psnr_to_top": psnr(float(measured.mean())) if len(measured) else float("nan"),
    }

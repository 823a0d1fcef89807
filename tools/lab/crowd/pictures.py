"""Pictures of crowds: hit rates, what edge and origin sent, stalls and start-ups, and what policies got."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from airgs_codec._report import plain_log_ticks
from tools.lab.crowd.runs import Run
from tools.lab.page import COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def most_mixed(runs: Sequence[Run]) -> list[Run]:
    """The runs of the population with most policies."""
    mixed = max((run.policies for run in runs), key=len)
    return [run for run in runs if run.policies == mixed]


def cache(runs: Sequence[Run], figure: Figure) -> None:
    """Hit rate by cache size, of the first run."""
    axes, rows = figure.add_subplot(), runs[0].cache
    sizes = [row["cache_mb"] for row in rows]
    for name, label in (("request_hit_rate", "requests"), ("byte_hit_rate", "bytes")):
        axes.plot(sizes, [100 * row[name] for row in rows], "o-", label=label)
    axes.axvline(runs[0].edge["files_mb"], color="grey", ls=":", label="all files that were asked for")
    axes.set(xscale="log", xlabel="cache, MB", ylabel="hits, %", ylim=(None, 100.5))
    plain_log_ticks(axes.xaxis)
    axes.legend(loc="lower right")


def egress(runs: Sequence[Run], figure: Figure) -> None:
    """Mbit/s over time of edge and origin."""
    left, right = figure.subplots(1, 2)
    for number, run in enumerate(runs):
        if run.population != runs[0].population:
            continue
        time = np.arange(len(run.seconds))
        colour = COLOURS[number % len(COLOURS)]
        left.plot(time, [8e-9 * s.egress_bytes for s in run.seconds], color=colour, label=run.bottleneck)
        right.plot(time, [max(1e-2, 8e-6 * s.origin_bytes) for s in run.seconds], color=colour, label=run.bottleneck)
    left.set(xlabel="time, s", ylabel="edge to viewers, Gbit/s", ylim=(0, None))
    right.set(xlabel="time, s", ylabel="origin to edge, Mbit/s", ylim=(0, None))
    left.legend(title="bottleneck")


def _distribution(axes: Axes, values: Sequence[float], **style: Any) -> None:
    """Share of viewers that have at most a value."""
    axes.step(np.sort(values), 100 * np.arange(1, len(values) + 1) / len(values), where="post", **style)


def stalls(runs: Sequence[Run], figure: Figure) -> None:
    """Who waits, and for how long, by bottleneck, of the first population."""
    left, right = figure.subplots(1, 2)
    for number, run in enumerate(run for run in runs if run.population == runs[0].population):
        style = {"color": COLOURS[number % len(COLOURS)], "label": run.bottleneck}
        _distribution(left, [s.startup_s for s in run.seen], **style)
        _distribution(right, [100 * s.stall_s / (s.stall_s + s.played_s) for s in run.seen], **style)
    left.set(xlabel="start-up, s", ylabel="viewers with at most this, %", xscale="log", ylim=(0, 100))
    plain_log_ticks(left.xaxis)
    right.set(xlabel="waiting after the first picture, % of the time", xlim=(-1, None), ylim=(0, 100))
    right.legend(title="bottleneck", loc="lower right")


def policies(runs: Sequence[Run], figure: Figure) -> None:
    """PSNR and bit rate of every viewer by policy, behind each bottleneck, in the population with most policies."""
    chosen = most_mixed(runs)
    mixed = chosen[0].policies
    panels = np.atleast_2d(figure.subplots(2, len(chosen), sharey=True, sharex="row", squeeze=False))
    for column, run in enumerate(chosen):
        for number, policy in enumerate(mixed):
            style = {"color": COLOURS[number], "label": policy}
            _distribution(panels[0, column], [s.psnr_mean for s in run.seen if s.policy == policy], **style)
            _distribution(panels[1, column], [s.bitrate_bps / 1e6 for s in run.seen if s.policy == policy], **style)
        panels[0, column].set(title=f"bottleneck {run.bottleneck}", xlabel="PSNR of a viewer, dB")
        panels[1, column].set(xlabel="bit rate of a viewer, Mbit/s")
    for row in panels:
        row[0].set(ylabel="viewers with at most this, %", ylim=(0, 100))
    panels[0, 0].legend(loc="upper left")

"""The picture of a crowd: hit rates by the size of the cache."""

from __future__ import annotations

from typing import TYPE_CHECKING

from airgs_codec._report import plain_log_ticks
from tools.lab.crowd.runs import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def cache(run: Run, figure: Figure) -> None:
    """Hit rate by cache size."""
    axes = figure.add_subplot()
    sizes = [row["cache_mb"] for row in run.cache]
    for name, label in (("request_hit_rate", "requests"), ("byte_hit_rate", "bytes")):
        axes.plot(sizes, [100 * row[name] for row in run.cache], "o-", label=label)
    axes.axvline(run.edge["files_mb"], color="grey", ls=":", label="all files that were asked for")
    axes.set(xscale="log", xlabel="cache, MB", ylabel="hits, %", ylim=(None, 100.5))
    plain_log_ticks(axes.xaxis)
    axes.legend(loc="lower right")

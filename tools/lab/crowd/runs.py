"""Several crowds: each population behind each bottleneck, and the figures of each."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from airgs_codec.package.package import open_package
from airgs_codec.play.trace import Trace
from tools.lab import Results, Row, content
from tools.lab.crowd.figures import busiest_bps, cache_rows, edge_row, policy_rows
from tools.lab.crowd.programme import Programme
from tools.lab.crowd.simulation import CrowdSettings, run_crowd

CACHES_MB = (1, 2, 4, 8, 16, 32, 64, 128, 256, 512)
NO_LIMIT = "none"


@dataclass(frozen=True, slots=True)
class Task:
    """A crowd that is to be simulated."""

    package: str
    traces: tuple[str, ...]
    settings: CrowdSettings
    bottleneck: str  # in words


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """The figures of a crowd."""

    policies: tuple[str, ...]
    bottleneck: str
    bottleneck_mbps: float | None
    busiest_mbps: float
    rows: list[Row]  # a policy each
    edge: Row
    cache: list[Row]

    @property
    def population(self) -> str:
        """The policies in words."""
        return ", ".join(self.policies)


def simulate_task(task: Task) -> Run:
    """Simulate a crowd and make its figures. Raises AirgsError."""
    s = task.settings
    programme = Programme(open_package(task.package), s.join_s + s.watch_s)
    traces = [Trace.open(trace) for trace in task.traces]
    outcome = run_crowd(programme, traces, s)
    return Run(
        policies=s.policies,
        bottleneck=task.bottleneck,
        bottleneck_mbps=s.bottleneck_bps / 1e6 if math.isfinite(s.bottleneck_bps) else None,
        busiest_mbps=busiest_bps(outcome) / 1e6,
        rows=policy_rows(outcome),
        edge=edge_row(outcome),
        cache=cache_rows(outcome, CACHES_MB),
    )


def run_all(first: Sequence[Task], shares: Sequence[float], results: Results) -> list[Run]:
    """Every population without a limit, then behind shares of what it took then in its busiest seconds.

    Where `first` has limits already, `shares` are empty. Raises AirgsError.
    """
    reads = [content(Path(path)) for path in (first[0].package, *first[0].traces)]
    runs = results.map("crowds", simulate_task, [(task,) for task in first], reads)
    runs += results.map("crowds", simulate_task, [(task,) for task in _limited(first, runs, shares)], reads)
    order = {task.settings.policies: number for number, task in enumerate(reversed(first))}
    return sorted(runs, key=lambda run: -order[run.policies])


def _limited(first: Sequence[Task], runs: Sequence[Run], shares: Sequence[float]) -> Iterator[Task]:
    for share in shares:
        for task, run in zip(first, runs, strict=True):
            limit = replace(task.settings, bottleneck_bps=1e6 * share * run.busiest_mbps)
            yield replace(task, settings=limit, bottleneck=f"{100 * share:g} %")


def trace_paths(folder: Path) -> tuple[str, ...]:
    """The traces of a folder by name."""
    return tuple(str(path) for path in sorted(folder.iterdir()) if path.is_file())

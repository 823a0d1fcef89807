"""Several crowds: each population behind each bottleneck, in processes of their own, and what is kept of them."""

from __future__ import annotations

import math
import multiprocessing
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

from airgs_codec.package.store import open_package
from airgs_codec.play.trace import open_trace
from airgs_codec.progress import Progress, silent
from tools.crowd.figures import Row, busiest_bps, cache_rows, edge_row, policy_rows
from tools.crowd.programme import Programme
from tools.crowd.simulation import CrowdSettings, Second, run_crowd
from tools.crowd.viewer import Seen

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
    """What is kept of a crowd."""

    policies: tuple[str, ...]
    bottleneck: str
    bottleneck_mbps: float | None
    busiest_mbps: float
    rows: list[Row]  # a policy each
    edge: Row
    cache: list[Row]
    seconds: tuple[Second, ...]
    seen: tuple[Seen, ...]
    wall_s: float  # of the simulation
    cpu_s: float

    @property
    def population(self) -> str:
        """The policies in words."""
        return ", ".join(self.policies)


def simulate_task(task: Task, progress: Progress = silent) -> Run:
    """Simulate a crowd and make its figures. Raises AirgsError."""
    wall_s, cpu_s, s = time.perf_counter(), time.process_time(), task.settings
    programme = Programme(open_package(task.package), s.join_s + s.watch_s)
    outcome = run_crowd(programme, [open_trace(trace) for trace in task.traces], s, progress)
    return Run(
        policies=s.policies,
        bottleneck=task.bottleneck,
        bottleneck_mbps=s.bottleneck_bps / 1e6 if math.isfinite(s.bottleneck_bps) else None,
        busiest_mbps=busiest_bps(outcome) / 1e6,
        rows=policy_rows(outcome),
        edge=edge_row(outcome),
        cache=cache_rows(outcome, CACHES_MB),
        seconds=outcome.seconds,
        seen=outcome.seen,
        wall_s=time.perf_counter() - wall_s,
        cpu_s=time.process_time() - cpu_s,
    )


def run_all(first: Sequence[Task], shares: Sequence[float], jobs: int, progress: Progress = silent) -> list[Run]:
    """Every population without a limit, then behind shares of what it took then in its busiest seconds.

    Where `first` has limits already, `shares` are empty. Raises AirgsError.
    """
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        done = 0
        runs: list[Run] = []
        for tasks in (lambda: list(first), lambda: list(_limited(first, runs, shares))):
            for run in pool.map(simulate_task, tasks()):
                runs.append(run)
                done += 1
                progress("crowds", done, len(first) * (1 + len(shares)))
    order = {task.settings.policies: number for number, task in enumerate(reversed(first))}
    return sorted(runs, key=lambda run: -order[run.policies])


def _limited(first: Sequence[Task], runs: Sequence[Run], shares: Sequence[float]) -> Iterator[Task]:
    for share in shares:
        for task, run in list(zip(first, runs, strict=False)):
            limit = replace(task.settings, bottleneck_bps=1e6 * share * run.busiest_mbps)
            yield replace(task, settings=limit, bottleneck=f"{100 * share:g} %")


def trace_paths(folder: Path) -> tuple[str, ...]:
    """The traces of a folder by name."""
    return tuple(str(path) for path in sorted(folder.iterdir()) if path.is_file())

"""Thousands of viewers of a scene over LTE traces, behind one shared link, an edge cache and an origin.

Every viewer is a real player with a real policy; bytes, files and qualities are those of a package, whose groups are
repeated as files of their own for as long as the programme goes on. Each population (--policies; names with commas
share one crowd) is simulated without a bottleneck, then behind links of 100 % and 50 % of what it took in its busiest
seconds; --bottleneck-mbps sets other ones (0: none).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

from airgs_codec.errors import ConfigError
from airgs_codec.jobs.engines import Processes
from airgs_codec.package.package import open_package
from airgs_codec.play.trace import Trace
from tools.lab import Lab, Page, nested, required, setting
from tools.lab.crowd.page import Prices, page
from tools.lab.crowd.policies import crowd_policy
from tools.lab.crowd.programme import Programme
from tools.lab.crowd.runs import NO_LIMIT, Task, run_all, trace_paths
from tools.lab.crowd.simulation import CrowdSettings
from tools.lab.made import encoded

SHARES = (1.0, 0.5)  # of what a crowd takes without a limit
POPULATIONS = ("robust-mpc", "robust-mpc,throughput,bola,paper")
DEFAULTS = CrowdSettings()


@dataclass(frozen=True, slots=True)
class Options:
    """Who watches what, and over what."""

    scene: str = required("a scene, SCENE[=VIEWS], or a package with measured quality")
    traces: Path = required("a folder of traces")
    viewers: int = setting(DEFAULTS.viewers, "of a crowd")
    policies: tuple[str, ...] = setting(POPULATIONS, "populations, P[,P...] each")
    bottleneck_mbps: tuple[float, ...] = setting((), "of the shared link, 0: none")
    cache_mb: float = setting(DEFAULTS.cache_bytes / 1e6, "of the edge")
    origin_mbps: float = setting(DEFAULTS.origin_bps / 1e6, "from the origin to the edge")
    origin_rtt_ms: float = setting(1e3 * DEFAULTS.origin_rtt_s, "from the edge to the origin")
    join: float = setting(DEFAULTS.join_s, "seconds in which viewers come")
    watch: float = setting(DEFAULTS.watch_s, "seconds of media that each watches")
    late: float = setting(DEFAULTS.late, "share that begins at the beginning")
    seed: int = setting(DEFAULTS.seed, "of the draw of viewers")
    jobs: int = setting(2, "processes, each with a crowd of its own")
    prices: Prices = nested(Prices, "prices")


def run(options: Options, lab: Lab) -> Page:
    """Simulate every crowd. Raises AirgsError."""
    tasks = make_tasks(options, encoded(options.scene, lab.folder))
    engine = Processes(options.jobs)
    try:
        runs = run_all(tasks, () if options.bottleneck_mbps else SHARES, replace(lab.results, engine=engine))
    finally:
        engine.close()
    return page(runs, tasks[0].settings, options.prices)


def make_tasks(options: Options, package: Path) -> list[Task]:
    """The crowds of a package that are simulated first. Raises AirgsError for inputs that cannot be."""
    if not options.traces.is_dir():
        raise ConfigError(f"{options.traces}: expected a folder of traces")
    if options.jobs < 1:
        raise ConfigError(f"--jobs: expected at least 1, got {options.jobs}")
    traces = trace_paths(options.traces)
    if not [Trace.open(trace) for trace in traces]:
        raise ConfigError(f"{options.traces}: expected traces, got an empty folder")
    limits = options.bottleneck_mbps or (0.0,)
    tasks = [
        Task(str(package), traces, _settings(options, population, limit), f"{limit:g} Mbit/s" if limit else NO_LIMIT)
        for limit in limits
        for population in options.policies
    ]
    short = Programme(open_package(package), 1e-3).whole
    for task in tasks:
        for name in task.settings.policies:
            crowd_policy(name, short)
    return tasks


def _settings(options: Options, population: str, limit_mbps: float) -> CrowdSettings:
    return CrowdSettings(
        viewers=options.viewers,
        policies=tuple(population.split(",")),
        join_s=options.join,
        watch_s=options.watch,
        late=options.late,
        bottleneck_bps=1e6 * limit_mbps if limit_mbps else math.inf,
        origin_bps=1e6 * options.origin_mbps,
        origin_rtt_s=options.origin_rtt_ms / 1e3,
        cache_bytes=1e6 * options.cache_mb,
        seed=options.seed,
    )

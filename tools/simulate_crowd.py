"""Thousands of viewers of a package over LTE traces, behind one shared link, an edge cache and an origin.

    python -m tools.simulate_crowd PACKAGE --traces DIR -o OUT [--viewers N] [--policy P[,P...] ...]

Every viewer is a real player with a real policy; bytes, files and qualities are those of the package, whose groups are
repeated as files of their own for as long as the programme goes on. Each population (--policy; names with commas share
one crowd) is simulated without a bottleneck, then behind links of 100 % and 50 % of what it took in its busiest
seconds; --bottleneck-mbps sets other ones (0: none).

Writes OUT/crowd.csv (a row a crowd and policy), crowd-cache.csv (hit rates by cache size), crowd.json (all of it with
machine, versions and command), pictures, and crowd.md with inputs, costs and a conclusion for every picture. Prices are
what --price says, by default examples.
"""

from __future__ import annotations

import argparse
import csv
import math
import os
import platform
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import matplotlib
import numba
import numpy as np

from airgs_codec._files import write_bytes, write_json
from airgs_codec._report import require_matplotlib
from airgs_codec.cli.common import Bar, run_command
from airgs_codec.errors import ConfigError
from airgs_codec.package.store import open_package
from airgs_codec.play.trace import open_trace
from tools.crowd.costs import Prices
from tools.crowd.figures import Row
from tools.crowd.inputs import rung_rows, stored_rows
from tools.crowd.page import Made, conclusions, page
from tools.crowd.pictures import draw
from tools.crowd.policies import crowd_policy
from tools.crowd.programme import Programme
from tools.crowd.runs import NO_LIMIT, Run, Task, run_all, trace_paths
from tools.crowd.simulation import CrowdSettings

SHARES = (1.0, 0.5)  # of what a crowd takes without a limit
POPULATIONS = ("robust-mpc", "robust-mpc,throughput,bola,paper")


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    s = CrowdSettings()
    parser.add_argument("package", type=Path, metavar="PACKAGE")
    parser.add_argument("--traces", type=Path, required=True, metavar="DIR")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="OUT")
    parser.add_argument("--viewers", type=int, default=s.viewers)
    parser.add_argument("--policy", nargs="+", default=POPULATIONS, metavar="P[,P...]", help="populations")
    parser.add_argument("--bottleneck-mbps", type=float, nargs="+", metavar="M", help="0: none")
    parser.add_argument("--cache-mb", type=float, default=s.cache_bytes / 1e6)
    parser.add_argument("--origin-mbps", type=float, default=s.origin_bps / 1e6)
    parser.add_argument("--origin-rtt", type=float, default=1e3 * s.origin_rtt_s, metavar="MS")
    parser.add_argument("--join", type=float, default=s.join_s, metavar="S", help="time in which viewers come")
    parser.add_argument("--watch", type=float, default=s.watch_s, metavar="S", help="media time of each")
    parser.add_argument("--late", type=float, default=s.late, help="share that begins at the beginning")
    parser.add_argument("--seed", type=int, default=s.seed)
    parser.add_argument("--jobs", type=int, default=2, help="processes, each with a crowd of its own")
    parser.add_argument("--price", action="append", default=[], metavar="NAME=PRICE", help=", ".join(_price_names()))
    parser.add_argument("--encode-core-s", type=float, default=0.0, help="core seconds to encode a second of media")
    parser.add_argument("--note", default="", metavar="TEXT", help="a sentence on the machine, for the page")
    return parser.parse_args(argv)


def _price_names() -> list[str]:
    return [field.name for field in fields(Prices)]


def read_prices(words: Sequence[str]) -> Prices:
    """Prices of NAME=PRICE. Raises ConfigError."""
    given: dict[str, float] = {}
    for word in words:
        name, _, price = word.partition("=")
        try:
            given[name] = float(price)
        except ValueError:
            raise ConfigError(f"--price {word}: expected NAME=PRICE") from None
        if name not in _price_names():
            raise ConfigError(f"--price {word}: expected one of {', '.join(_price_names())}")
    return Prices(**given)


def make_tasks(args: argparse.Namespace) -> list[Task]:
    """The crowds that are simulated first. Raises AirgsError for inputs that cannot be."""
    if not args.traces.is_dir():
        raise ConfigError(f"--traces {args.traces}: expected a folder of traces")
    if args.jobs < 1:
        raise ConfigError(f"--jobs: expected at least 1, got {args.jobs}")
    traces = trace_paths(args.traces)
    if not [open_trace(trace) for trace in traces]:
        raise ConfigError(f"--traces {args.traces}: expected traces, got an empty folder")
    limits = [0.0] if args.bottleneck_mbps is None else args.bottleneck_mbps
    tasks = [
        Task(str(args.package), traces, _settings(args, population, limit), f"{limit:g} Mbit/s" if limit else NO_LIMIT)
        for limit in limits
        for population in args.policy
    ]
    short = Programme(open_package(args.package), 1e-3).whole
    for task in tasks:
        for name in task.settings.policies:
            crowd_policy(name, short)
    return tasks


def _settings(args: argparse.Namespace, population: str, limit_mbps: float) -> CrowdSettings:
    return CrowdSettings(
        viewers=args.viewers,
        policies=tuple(population.split(",")),
        join_s=args.join,
        watch_s=args.watch,
        late=args.late,
        bottleneck_bps=1e6 * limit_mbps if limit_mbps else math.inf,
        origin_bps=1e6 * args.origin_mbps,
        origin_rtt_s=args.origin_rtt / 1e3,
        cache_bytes=1e6 * args.cache_mb,
        seed=args.seed,
    )


def command_of(args: argparse.Namespace) -> str:
    """The command with plain names for folders."""
    skipped = {"package", "traces", "output", "note", "words"}
    defaults = parse([str(args.package), "--traces", ".", "-o", "."])
    words = [f"python -m tools.simulate_crowd {args.package.name} --traces {args.traces.name}/ -o out/"]
    for name, value in vars(args).items():
        if name in skipped or value == getattr(defaults, name):
            continue
        option = f"--{name.replace('_', '-')}"
        plain = value if isinstance(value, list) else [value]
        words += [f"{option} {word}" for word in plain] if name == "price" else [" ".join([option, *map(str, plain)])]
    return " ".join(words)


def table_of(runs: Sequence[Run]) -> list[Row]:
    """A row a crowd and policy."""
    shared = ("bottleneck", "bottleneck_mbps", "wall_s", "cpu_s")
    return [
        {"policies": run.population}
        | {name: getattr(run, name) for name in shared}
        | row
        | {f"edge_{name}": value for name, value in run.edge.items()}
        for run in runs
        for row in run.rows
    ]


def write(runs: Sequence[Run], made: Made, record: dict[str, Any], folder: Path) -> None:
    """Tables, pictures and the page. Raises ConfigError."""
    caches = [{"policies": r.population, "bottleneck": r.bottleneck} | row for r in runs for row in r.cache]
    for name, rows in (("crowd.csv", table_of(runs)), ("crowd-cache.csv", caches)):
        with (folder / name).open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows)
    crowds = {"crowds": table_of(runs), "cache": caches, "rungs": made.rungs, "stored": made.stored}
    seconds = [[asdict(second) for second in run.seconds] for run in runs]
    write_json(folder / "crowd.json", record | crowds | {"prices": asdict(made.prices), "seconds": seconds})
    draw(runs, folder)
    write_bytes(folder / "crowd.md", page(runs, made).encode())


def run(args: argparse.Namespace) -> int:
    """Simulate and write everything. Raises AirgsError."""
    require_matplotlib("a picture")
    prices, tasks, began = read_prices(args.price), make_tasks(args), time.perf_counter()
    package = open_package(args.package)
    args.output.mkdir(parents=True, exist_ok=True)
    bar = Bar()
    try:
        runs = run_all(tasks, SHARES if args.bottleneck_mbps is None else (), args.jobs, bar)
    finally:
        bar.close()
    seconds = time.perf_counter() - began
    versions = {"numpy": np.__version__, "numba": numba.__version__, "matplotlib": matplotlib.__version__}
    machine = {"processor": platform.machine(), "cores": os.cpu_count(), "python": platform.python_version()}
    words = (
        f"Measured on {machine['cores']} {machine['processor']} cores with Python {machine['python']}, numpy "
        f"{np.__version__} and numba {numba.__version__}, {args.jobs} crowds at once, {seconds:.0f} s in all."
    )
    made = Made(
        command_of(args),
        f"{words} {args.note}".strip(),
        rung_rows(package),
        stored_rows(package),
        prices,
        args.encode_core_s,
    )
    record = {"command": made.command, "seconds": seconds, "note": args.note, "machine": machine}
    write(runs, made, record | {"versions": versions}, args.output)
    print(*conclusions(runs).values(), f"{seconds:.0f} s, {args.output}", sep="\n")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Run; gives the exit status."""
    args = parse(argv)
    return run_command("simulate_crowd", lambda: run(args))


if __name__ == "__main__":
    sys.exit(main())

"""How fast the selector, the bounds and the simulator are on this machine.

    python -m tools.bench_play PACKAGE TRACE [--scale X]

Microseconds of `Ladder.build` and `select` over the number of levels; milliseconds of the horizon's programmes, and how
far the linear one is above the integer one; sessions of 30 s of play for each policy, as multiples of real time.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from airgs_codec.package.store import open_package
from airgs_codec.play.catalogue import Catalogue
from airgs_codec.play.ladder import Ladder, Option, select
from airgs_codec.play.link import Link
from airgs_codec.play.policies.named import NAMES
from airgs_codec.play.regret import session_bound
from airgs_codec.play.session import simulate
from airgs_codec.play.trace import open_trace

LEVELS = (4, 11, 100, 1000, 10_000)
REPEATS = 7


def seconds(work: Callable[[], object], least_s: float = 0.05) -> float:
    """Median over REPEATS of the time of one call."""
    count, took = 1, 0.0
    while took < least_s:
        began = time.perf_counter()
        for _ in range(count):
            work()
        took = time.perf_counter() - began
        count *= 1 if took >= least_s else 4
    runs = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        for _ in range(count):
            work()
        runs.append((time.perf_counter() - began) / count)
    return float(np.median(runs))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("package", type=Path)
    parser.add_argument("trace")
    parser.add_argument("--scale", type=float, default=1.0)
    args = parser.parse_args()
    print(f"{'levels':>8}{'build us':>12}{'a level':>10}{'select us':>12}")
    for count in LEVELS:
        points = [Option(i, 1000 * (count - i), 60 - 20 * i / count, i / count) for i in range(count)]
        ladder = Ladder.build(points, beta=math.inf, cliff_db=math.inf)
        build = seconds(lambda p=points: Ladder.build(p, beta=math.inf, cliff_db=math.inf))  # type: ignore[misc]
        choose = seconds(lambda x=ladder, c=count: select(x, 500.0 * c))  # type: ignore[misc]
        print(f"{count:8d}{1e6 * build:12.1f}{1e6 * build / count:10.2f}{1e6 * choose:12.2f}")
    package = open_package(args.package)
    c = Catalogue.of(package)
    link = Link(open_trace(args.trace).cut(scale=args.scale))
    heads = f"{'ms a session':>14}{'x real time':>13}{'LP bound ms':>13}{'MILP ms':>10}{'LP - MILP dB':>14}"
    print(f"\n{'policy':<16}{heads}")
    for name in (*NAMES, "fixed:0"):
        log = simulate(c, link, name)
        took = seconds(lambda n=name: simulate(c, link, n))  # type: ignore[misc]
        played = sum(s.frames for s in log.shown) / c.fps
        relaxed, exact = (session_bound(log, integer) for integer in (False, True))
        lp, milp = (seconds(lambda x=log, i=i: session_bound(x, i), 0.0) for i in (False, True))  # type: ignore[misc]
        gap = math.nan if relaxed is None or exact is None else relaxed - exact
        print(f"{name:<16}{1e3 * took:14.1f}{played / took:13.0f}{1e3 * lp:13.1f}{1e3 * milp:10.1f}{gap:14.4f}")


if __name__ == "__main__":
    main()

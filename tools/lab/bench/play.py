"""How fast the selector, the bounds and the simulator are.

Microseconds of `Ladder.build` and `select` over the number of levels; milliseconds of sessions of 30 s of play for each
policy, as multiples of real time, and of the horizon's programmes, with how far the linear one is above the integer.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from airgs_codec.package.package import open_package
from airgs_codec.play.ladder import Ladder, Option, select
from airgs_codec.play.offers import Offers
from airgs_codec.play.policies.named import NAMES
from airgs_codec.play.session import session_bound, simulate
from airgs_codec.play.trace import Link, Trace
from tools.lab import Lab, Page, Row, Section, Table, required, setting

LEVELS = (4, 11, 100, 1000, 10_000)
REPEATS = 7


@dataclass(frozen=True, slots=True)
class Options:
    """What is played."""

    package: Path = required("a package")
    trace: str = required("a trace, as airgs-play takes it")
    scale: float = setting(1.0, "factor on the rates of the trace")


def run(options: Options, lab: Lab) -> Page:
    """Both tables."""
    offers = Offers.of(open_package(options.package))
    link = Link(Trace.open(options.trace).cut(scale=options.scale))
    ladders = [ladder_row(count) for count in LEVELS]
    policies = [policy_row(offers, link, name) for name in (*NAMES, "fixed:0")]
    most = ladders[-1]
    answer = f"A choice among {most['levels']:,d} levels takes {most['select, us']:.1f} us, a session "
    answer += f"{min(p['ms a session'] for p in policies):.0f} to {max(p['ms a session'] for p in policies):.0f} ms."
    tables = [Table("play-ladders", ladders), Table("play-policies", policies)]
    return Page([Section(answer, tables=tables)])


def ladder_row(count: int) -> Row:
    """Of a ladder of so many levels."""
    points = [Option(i, 1000 * (count - i), 60 - 20 * i / count, i / count) for i in range(count)]
    ladder = Ladder.build(points, beta=math.inf, cliff_db=math.inf)
    build = 1e6 * seconds(lambda: Ladder.build(points, beta=math.inf, cliff_db=math.inf))
    choose = 1e6 * seconds(lambda: select(ladder, 500.0 * count))
    return {"levels": count, "build, us": build, "a level, us": build / count, "select, us": choose}


def policy_row(offers: Offers, link: Link, name: str) -> Row:
    """Of sessions of a policy and their bounds."""
    log = simulate(offers, link, name)
    took = seconds(lambda: simulate(offers, link, name))
    played = sum(s.frames for s in log.shown) / offers.fps
    relaxed, exact = (session_bound(log, integer) for integer in (False, True))
    lp, milp = (1e3 * seconds(lambda i=i: session_bound(log, i), 0.0) for i in (False, True))  # type: ignore[misc]
    gap = None if relaxed is None or exact is None else relaxed - exact
    return {
        "policy": name, "ms a session": 1e3 * took, "x real time": played / took, "LP bound, ms": lp, "MILP, ms": milp,
        "LP - MILP, dB": gap,
    }  # fmt: skip


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

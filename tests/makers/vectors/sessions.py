"""Whole sessions over simulated links: regression vectors, made by the player.

Each tells what was fetched when, what was given up and replaced, and what was shown.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from itertools import count
from typing import Any

import numpy as np

from airgs_codec.errors import FormatError
from airgs_codec.package.layout import JSON_NAME
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.package import open_package
from airgs_codec.play.downloader import (
    Arrival,
    Arrived,
    Cut,
    Event,
    GiveUp,
    Lost,
    Replaced,
    Request,
    SimulatedDownloader,
)
from airgs_codec.play.offers import NONE
from airgs_codec.play.player import run
from airgs_codec.play.policies.named import ADAPTIVE, make_policy
from airgs_codec.play.settings import SessionSettings
from airgs_codec.play.trace import Link, Trace
from tests.makers.vectors.text import Table, plain
from tests.support.paths import GOLDEN
from tests.support.session_packages import Numbers, growing_offers, numbers_of, offers_of

TRACE_S = 60
POLICIES = (*ADAPTIVE, "fixed:0", "fixed:Q1+L1")
VARIANTS = ("paper-no-cliff", "paper-literal", "paper-literal-no-cliff")  # they differ from `paper` in the choice alone
COMMON = tuple(policy for policy in POLICIES if policy not in VARIANTS)


@dataclass(frozen=True, slots=True)
class Play:
    """A session: indices of a package and of a trace, and what a player is told."""

    package: int
    trace: int
    policy: str
    rtt_s: float = 0.08
    settings: dict[str, Any] = field(default_factory=dict)  # other than the defaults
    faults: dict[str, str] = field(default_factory=dict)  # path -> reason why it cannot be used
    pipelines: bool = True
    growth: list[int] = field(default_factory=list)  # groups each time that airgs.json is read; empty: the whole


def drawn_package(rng: np.random.Generator) -> Numbers:
    """Three groups of five segments, each shorter or longer, whose tiers may have no rows and segments no file."""
    groups = []
    for _ in range(3):
        some = rng.uniform(size=3) > 0.2
        some[0] = True
        keys = rng.uniform(4e3, 2e4, 3) * some
        groups.append(
            {
                "table": int(rng.integers(600, 2000)),
                "sidecars": [int(key / 4) for key in keys],
                "pictures": [[int(key * 0.6**q) for q in range(2)] for key in keys],
                "segments": [_segment(int(frames), rng) for frames in rng.integers(12, 30, 5)],
            }
        )
    levels = [{"id": f"L{j}", "tiers": max(1, 3 - j), "pruned": round(0.25 * j, 2)} for j in range(4)]
    return _numbers("drawn", [24, 1], levels, groups)


KEEPING = {  # group -> the number of its base; of each tier what its pictures are to those of the base
    1: (1, (0.2, 0.3, 0.1)),
    3: (3, (0.4, 0.6, 0.5)),
    4: (3, (0.0, 0.1, 0.0)),
}


def kept_package(rng: np.random.Generator) -> Numbers:
    """Five groups, some of which are differences to one before, of which some tiers have no pictures."""
    first, second = drawn_package(rng), drawn_package(rng)
    groups = [*first["groups"], *second["groups"][:2]]
    for number, (base, shares) in KEEPING.items():
        of = groups[base - 1]
        sidecars = [size and 40 + size // 4 for size in of["sidecars"]]
        pictures = [[int(size * share) for size in sizes] for sizes, share in zip(of["pictures"], shares, strict=True)]
        groups[number] = groups[number] | {"keeps": base, "sidecars": sidecars, "pictures": pictures}
    return {**first, "name": "kept", "groups": groups}


def sounding_package(rng: np.random.Generator) -> Numbers:
    """The groups of the drawn package with sound, in whose time one has none."""
    drawn = drawn_package(rng)
    sounds = [7400, 0, 9100]
    groups = [group | {"sound": size} for group, size in zip(drawn["groups"], sounds, strict=True)]
    return {**drawn, "name": "sounding", "groups": groups}


def _segment(frames: int, rng: np.random.Generator) -> dict[str, Any]:
    best, most = rng.uniform(33, 42), rng.uniform(1e3, 2.5e3) * frames
    sizes = [int(most * 0.55**j * rng.uniform(0.9, 1.1)) for j in range(4)]
    if rng.uniform() < 0.2:
        sizes[-1] = 0
    psnr = [[round(best - 1.6 * j - 0.8 * q + rng.uniform(-0.4, 0.4), 2) for q in range(2)] for j in range(4)]
    return {"frames": frames, "bytes": sizes, "psnr": psnr}


def paged_package() -> Numbers:
    """68 groups of a segment each, so that one page of the index comes into being as it grows."""
    psnr = [[38.0, 36.0], [35.0, 33.0]]
    groups = [
        {
            "table": 200 + number % 7,
            "sidecars": [300],
            "pictures": [[2000 + 10 * number, 1200 + 10 * number]],
            "segments": [{"frames": 10, "bytes": [3000 + 20 * number, 1000 + 20 * number], "psnr": psnr}],
        }
        for number in range(68)
    ]
    levels = [{"id": "L0", "tiers": 1, "pruned": 0.0}, {"id": "L1", "tiers": 1, "pruned": 0.5}]
    return _numbers("paged", [20, 1], levels, groups)


def _numbers(name: str, frame_rate: list[int], levels: list[dict[str, Any]], groups: list[Any]) -> Numbers:
    head = {"name": name, "frame_rate": frame_rate, "header_bytes": 350, "root_bytes": 3000, "page_bytes": 4000}
    return head | {"qualities": ["Q0", "Q1"], "levels": levels, "groups": groups}


def packages() -> list[Numbers]:
    fox = open_package(GOLDEN / "fox")
    drawn, kept = drawn_package(np.random.default_rng(31)), kept_package(np.random.default_rng(33))
    sounding = sounding_package(np.random.default_rng(34))
    return [drawn, numbers_of(fox.manifest, "fox", fox.root_bytes), paged_package(), kept, sounding]


def traces(numbers: Numbers, rng: np.random.Generator) -> list[Trace]:
    """A constant link, one with steps, one with outages, and one that wanders as LTE does; about as fast as a middle
    rung needs.
    """
    c = offers_of(numbers)
    middle = sum(float(np.median(c.offer(s).sizes(NONE))) * 8 for s in range(c.segments)) / c.duration_s
    steps = Trace("steps", np.array([0.0, 5, 9, 14]), np.array([1.0, 0.25, 3.0, 0.6]), 22.0)
    outages = Trace("outages", np.array([0.0, 3, 5.5, 12, 12.75]), np.array([1.5, 0.0, 1.5, 0.05, 4.0]), 20.0)
    wander = np.exp(np.cumsum(rng.normal(0, 0.5, TRACE_S) - 0.02)) + 0.05
    lte = Trace("LTE-like", np.arange(TRACE_S, dtype=float), wander / wander.mean(), float(TRACE_S))
    shapes = [Trace("constant", np.zeros(1), np.ones(1), 3600.0), steps, outages, lte]
    return [Trace(t.name, t.starts_s, np.round(t.rates_bps * middle), t.duration_s) for t in shapes]


def plays() -> Iterator[Play]:
    """The policies over the traces, the rules in turn; then faults, and a package that grows."""
    turn = count()
    for package in (0, 1):
        for number, policy in enumerate(POLICIES if package == 0 else COMMON):
            often = package == 0 and policy in ADAPTIVE and policy not in VARIANTS
            for trace in range(4) if often else (number % 4,):
                yield Play(package, 4 * package + trace, policy, settings=_rules(package, next(turn)))
    bad = {"state/L0/2.m4s": "hash_mismatch", "key/T0/Q0/2.m4s": "missing_file"}
    yield Play(0, 0, "paper", faults=bad)
    yield Play(0, 3, "robust-mpc", faults={"group/2.json.gz": "missing_file"}, pipelines=False)
    yield Play(0, 1, "bola", faults={"key/T0/1.bin": "hash_mismatch", "key/T0/3.bin": "missing_file"})
    yield Play(2, 8, "throughput", settings={"loops": 1}, growth=[2, 3, 3, 5, 6])
    yield Play(2, 11, "paper", growth=[62, 63, 65, 66, 68])
    yield Play(2, 8, "robust-mpc", growth=[64, 65, 67], settings={"buffer_s": 2.0})
    yield Play(2, 10, "paper", growth=[60, 61, *[62] * 200], faults={"group/61.json.gz": "missing_file"})
    for number, policy in enumerate(COMMON):
        yield Play(3, 12 + number % 4, policy, settings=_rules(0, next(turn)))
    yield Play(3, 12, "robust-mpc", faults={"key/T0/1.bin": "hash_mismatch", "group/3.json.gz": "missing_file"})
    yield Play(3, 13, "throughput", growth=[2, 3, 4, 5])
    yield Play(4, 18, "paper", settings={"loops": 1})
    bad = {"sound/1.m4a": "missing_file", "key/T0/3.bin": "hash_mismatch"}
    yield Play(4, 16, "robust-mpc", faults=bad, settings={"loops": 1})


def _rules(package: int, turn: int) -> dict[str, Any]:
    rules: dict[str, Any] = {"loops": (2, 18)[package]}
    rules |= {"abandon": turn % 4 != 1, "replace": turn % 4 != 2, "pipelined": turn % 3 != 1}
    if turn % 5 == 2:
        rules |= {"buffer_s": 3.0, "startup_s": 0.0, "resume_s": 0.0, "decode_frame_s": 0.0}
    return rules


class GrowingDownloader:
    """A simulated downloader over a package to which groups are added whenever airgs.json is read again."""

    def __init__(self, below: SimulatedDownloader, steps: Iterator[tuple[Manifest, int]]) -> None:
        self._below, self._steps, self._opened = below, steps, False
        self.rtt_s, self.pipelines = below.rtt_s, below.pipelines

    def fetch(self, request: Request, give_up: GiveUp | None = None) -> Arrival:
        grows = self._opened and request.batch.tables == (JSON_NAME,)
        if grows and (step := next(self._steps, None)) is not None:
            self._below.offers.grow(*step)
        self._opened = True
        return self._below.fetch(request, give_up)


def events(play: Play, numbers: Numbers, trace: Trace) -> list[list[Any]]:
    offers = offers_of(numbers)
    faults = {path: FormatError(reason, path, "made up") for path, reason in play.faults.items()}
    if play.growth:
        offers, steps = growing_offers(numbers, play.growth)
    below = SimulatedDownloader(Link(trace, play.rtt_s), offers, faults, play.pipelines)
    downloader = GrowingDownloader(below, steps) if play.growth else below
    policy = make_policy(play.policy, offers)
    return [row(event) for event in run(offers, downloader, policy, SessionSettings(**play.settings))]


def row(event: Event) -> list[Any]:
    match event:
        case Arrived(a):
            r = a.request
            times = plain([r.sent_s, a.first_byte_s, a.at_s])
            files = [int(a.abandoned), len(a.whole), len(a.refused)]
            return [r.kind.value, r.position, r.rung, a.bytes, *times, *files]
        case Replaced():
            return ["replaced", event.position, event.before, event.after]
        case Lost():
            return ["lost", event.position, plain(event.at_s)]
        case Cut():
            return ["cut", plain(event.at_s)]
    times = plain([event.ready_s, event.start_s, event.stall_s])
    return ["shown", event.segment, event.loop, -1 if event.rung is None else event.rung, event.frames, *times]


def table() -> Table:
    played = packages()
    rng = np.random.default_rng(32)
    links = [trace for numbers in played for trace in traces(numbers, rng)]
    rows = [asdict(play) | {"events": events(play, played[play.package], links[play.trace])} for play in plays()]
    return {"packages": [dict(numbers) for numbers in played], "traces": [_trace(t) for t in links], "sessions": rows}


def _trace(t: Trace) -> dict[str, Any]:
    starts, rates = (plain(values.tolist()) for values in (t.starts_s, t.rates_bps))
    return {"name": t.name, "starts_s": starts, "rates_bps": rates, "duration_s": t.duration_s}

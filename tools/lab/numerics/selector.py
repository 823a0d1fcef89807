"""Quality of experience over links against microseconds a choice: policies, and how far the default one looks ahead.

QoE of a session is what its report says: quality less changes and waiting. Links have one and a half times the rate of
the top rung on average, where what is best is seldom in doubt, or three quarters of it. They are traces at that rate
where folders of them are given, or made ones of a seed each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from unittest.mock import patch

import numpy as np

from airgs_codec.play import policies as known
from airgs_codec.play.ladder import Decision
from airgs_codec.play.offers import Offers
from airgs_codec.play.playout import SessionSettings
from airgs_codec.play.policies import ADAPTIVE, DEFAULT_POLICY, PlayerState, Policy, make_policy
from airgs_codec.play.session import simulate
from airgs_codec.play.trace import Link, Trace, markov_trace
from tools.lab import Took, seconds_of
from tools.lab.numerics.rows import Bench, Place, Point, Row, average

AMPLE, SCARCE = "ample links", "scarce links"
SHARES = {AMPLE: 1.5, SCARCE: 0.75}  # of the top rung's rate that a link has on average
PLAY_S = 30.0
HORIZONS, QUICK_HORIZONS = (1, 2, 4, 8, 12), (1, 4)  # segments
MADE, QUICK_MADE = 8, 3  # links where no traces are given
FAR_S = 99.0  # seconds that no horizon in segments reaches
UNIT = "dB of QoE"

Maker = Callable[[Link], Policy]


@dataclass(frozen=True, slots=True, eq=False)
class Links:
    offers: Offers
    traces: tuple[Trace, ...]  # none: made ones
    made: int

    def over(self, share: float) -> Iterator[Link]:
        m = self.offers.manifest
        wanted = share * 8 * m.bytes_of(m.rung_files(0, 0)) / self.offers.duration_s
        for trace in self.traces:
            yield Link(trace.cut(trace.duration_s / 2, wanted / trace.mean_bps))
        if not self.traces:
            yield from (Link(markov_trace(seed, wanted)) for seed in range(self.made))


def policies(bench: Bench) -> Iterator[Point]:
    yield from _points(bench, "policies", [(name, partial(_named, name)) for name in ADAPTIVE])


def horizons(bench: Bench) -> Iterator[Point]:
    counts = QUICK_HORIZONS if bench.quick else HORIZONS
    yield from _points(bench, "horizon", [(str(count), partial(_looking, count)) for count in counts])


def _points(
    bench: Bench, question: str, ways: Sequence[tuple[str, Callable[[Links, Link], Policy]]]
) -> Iterator[Point]:
    scene = bench.scenes[0]
    links = Links(Offers.of(bench.ladder(scene)), bench.traces, QUICK_MADE if bench.quick else MADE)
    for kind, share in SHARES.items():
        for name, make in ways:
            place = Place(question, f"{scene.name}, {kind}", question, name)
            reads = {"place": place, "links": [trace.name for trace in bench.traces] or links.made}
            yield Point("sessions", scene, reads, partial(sessions, links, place, share, partial(make, links)))


def _named(name: str, links: Links, link: Link) -> Policy:
    return make_policy(name, links.offers, link)


def _looking(segments: int, links: Links, link: Link) -> Policy:
    policy = make_policy(DEFAULT_POLICY, links.offers, link)

    def choose(state: PlayerState) -> Decision:
        with patch.multiple(known, HORIZON_SEGMENTS=segments, HORIZON_S=FAR_S):
            return policy.choose(state)

    return replace(policy, choose=choose)


def sessions(links: Links, place: Place, share: float, make: Maker) -> list[Row]:
    """What single choices take, and how good sessions are and how much of the time they wait on average."""
    rules = SessionSettings(loops=max(1, round(PLAY_S / links.offers.duration_s)))
    took: list[Took] = []
    experience, waits = [], []
    for link in links.over(share):
        metrics = simulate(links.offers, link, watched(make(link), took), rules).metrics
        assert metrics.qoe is not None
        experience.append(metrics.qoe)
        waits.append(metrics.stall_ratio)
    note = f"{100 * float(np.mean(waits)):.1f} % waiting"
    return [Row.by(place, took, average(experience), UNIT, note, experience)]


def watched(policy: Policy, took: list[Took]) -> Policy:

    def choose(state: PlayerState) -> Decision:
        seconds, decision = seconds_of(lambda: policy.choose(state))
        took.append(seconds)
        return decision

    return replace(policy, choose=choose)

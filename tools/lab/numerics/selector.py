"""Regret of choices of rungs against microseconds a choice: policies, how far they look, how they solve.

Regret is the distance in dB of a session's mean quality to the bound of the linear programme for the same display
times. Sessions are played over seeded links of one and a half times the rate of the top rung. Levels that are denser
than those of a package lie between its own, linear in dB and the logarithm of bytes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from airgs_codec.play.bound import solve_horizon
from airgs_codec.play.ladder import Decision, Ladder, Option, select
from airgs_codec.play.offers import Offers
from airgs_codec.play.policies import mpc
from airgs_codec.play.policies.named import ADAPTIVE, NAMES, make_policy
from airgs_codec.play.policies.oracle import choose_oracle_frame, upcoming_horizon
from airgs_codec.play.policies.state import PlayerState, Policy
from airgs_codec.play.session import session_bound, simulate
from airgs_codec.play.settings import SessionSettings
from airgs_codec.play.trace import Link, markov_trace
from tools.lab.numerics.rows import Bench, Place, Point, Row, Scene
from tools.lab.paper.frames import frame_options, paper_programme
from tools.lab.timing import Took, seconds_of, timed

SHARE = 1.5  # of the top rung's rate that a link has on average
PLAY_S = 20.0
HORIZONS, QUICK_HORIZONS = (1, 2, 4, 8), (1, 4)  # segments
LEVELS, QUICK_LEVELS = (4, 8, 16, 32, 64), (4, 16)
FRAMES = 96  # of the programme with dense levels
MPC = max(ADAPTIVE.values(), key=lambda policy: policy.horizon).name  # the one that looks furthest ahead
LP, MILP, GREEDY = "LP, link known", "MILP, link known", "greedy, link known"
DENSE_MILP, DENSE_LP, DENSE_GREEDY = "MILP of all frames", "LP, rounded down", "greedy, frame by frame"
UNIT, QOE = "dB of regret", "dB of QoE"


@dataclass(frozen=True, slots=True, eq=False)
class Links:
    """What sessions are played over."""

    offers: Offers
    count: int

    def link(self, seed: int) -> Link:
        """A link of a seed."""
        m, c = self.offers.manifest, self.offers
        return Link(markov_trace(seed, SHARE * 8 * m.bytes_of(m.rung_files(0, 0)) / c.duration_s))


def measure(bench: Bench) -> Iterator[Point]:
    """Policies by name, by horizon, and choices among dense levels, with the ladder of the first scene."""
    scene = bench.scenes[0]
    links = Links(Offers.of(bench.ladder(scene)), 3 if bench.quick else 8)
    for place, make in policies(scene, links, QUICK_HORIZONS if bench.quick else HORIZONS):
        yield Point("sessions", scene, {"place": place, "links": links.count}, partial(_sessions, links, place, make))
    for count in QUICK_LEVELS if bench.quick else LEVELS:
        yield Point("dense levels", scene, {"count": count}, partial(dense, links, scene, count))


Maker = Callable[[Link], Policy]


def policies(scene: Scene, links: Links, horizons: Sequence[int]) -> Iterator[tuple[Place, Maker]]:
    """(place, policy over a link) of every point."""
    for name in NAMES:
        make: Maker = partial(make_policy, name, links.offers)
        yield Place("selector", "policies", scene.name, name, name), make
    for h in horizons:
        yield Place("selector", "horizon", scene.name, MPC, str(h)), partial(_mpc, links, h)
        yield Place("selector", "horizon", scene.name, LP, str(h)), partial(_planner, h, False)
        yield Place("selector", "horizon", scene.name, MILP, str(h)), partial(_planner, h, True)
    yield Place("selector", "horizon", scene.name, GREEDY, "1"), _greedy


def _mpc(links: Links, horizon: int, link: Link) -> Policy:
    """The controller that looks at so many segments."""
    policy = make_policy(MPC, links.offers, link)

    def choose(state: PlayerState) -> Decision:
        with patch.object(mpc, "HORIZON_SEGMENTS", horizon):
            return policy.choose(state)

    return replace(policy, choose=choose)


def _planner(horizon: int, integer: bool, link: Link) -> Policy:
    """The programme of so many segments, whose first rung is taken; the link is known."""

    def choose(state: PlayerState) -> Decision:
        whole = upcoming_horizon(state, link)
        schedule = solve_horizon(replace(whole, slots=whole.slots[:horizon]), integer)
        smallest = min(state.options, key=lambda option: option.size_bytes)
        wanted = smallest.index if schedule is None else int(schedule.rungs[0].argmax())
        option = next((o for o in state.options if o.index == wanted), smallest)
        return Decision(option.index, schedule is not None, "planned", option.size_bytes)

    return Policy("planner", choose, may_replace=False)


def _greedy(link: Link) -> Policy:
    return Policy("greedy", lambda state: choose_oracle_frame(state, link), may_replace=False)


def _sessions(links: Links, place: Place, make: Maker) -> list[Row]:
    """What single choices take; the regret of every session, and its QoE, which counts waiting and changes, too."""
    rules = SessionSettings(loops=max(1, round(PLAY_S / links.offers.duration_s)))
    took: list[Took] = []
    regrets, experience = [], []
    for seed in range(links.count):
        link = links.link(seed)
        log = simulate(links.offers, link, watched(make(link), took), rules)
        bound = session_bound(log)
        assert bound is not None and log.metrics.qoe is not None
        regrets.append(bound - log.mean_quality)
        experience.append(log.metrics.qoe)
    qoe = place._replace(panel=f"{place.panel} qoe")
    return [Row.of(place, took, regrets, UNIT), Row.of(qoe, took, experience, QOE)]


def watched(policy: Policy, took: list[Took]) -> Policy:
    """The policy, which notes how long every choice takes."""

    def choose(state: PlayerState) -> Decision:
        seconds, decision = seconds_of(lambda: policy.choose(state))
        took.append(seconds)
        return decision

    return replace(policy, choose=choose)


def dense(links: Links, scene: Scene, count: int) -> list[Row]:
    """Ways to choose one of so many levels for each frame within what the link carries in its time."""
    c = links.offers
    sizes, quality = dense_levels(frame_options(c, keys=True), count)
    trace = links.link(0).trace
    times = np.arange(len(sizes)) / c.fps
    budgets = np.array([trace.rate_at(t) for t in times]) / 8 / c.fps
    budgets = np.maximum(budgets, sizes[:, -1])  # what nobody could keep is no regret of a choice
    best = best_possible(sizes, quality, budgets)
    ways: dict[str, Callable[[], float]] = {
        DENSE_MILP: lambda: float((paper_programme(sizes, quality, budgets)[0] * quality).sum() / len(sizes)),
        DENSE_LP: lambda: relaxed(sizes, quality, budgets),
        DENSE_GREEDY: lambda: greedy(sizes, quality, budgets),
    }
    rows = []
    for name, choose in ways.items():
        took = [t.times(1 / len(sizes)) for t in timed(choose, 5)]
        place = Place("selector", "levels", scene.name, name, str(count))
        rows.append(Row.of(place, took, [best - choose()], UNIT))
    return rows


def dense_levels(frames: Sequence[Sequence[Option]], count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(FRAMES, count) bytes and dB, falling; the frames in turn, each with levels between its own."""
    sizes, quality = np.empty((FRAMES, count)), np.empty((FRAMES, count))
    for t in range(FRAMES):
        front = Ladder.build(frames[t % len(frames)], beta=math.inf, cliff_db=math.inf).options[::-1]
        logs = np.log([max(1, option.size_bytes) for option in front])
        wanted = np.linspace(logs[-1], logs[0], count)
        sizes[t], quality[t] = np.exp(wanted), np.interp(wanted, logs, [option.quality for option in front])
    return sizes, quality


def best_possible(sizes: NDArray[np.float64], quality: NDArray[np.float64], budgets: NDArray[np.float64]) -> float:
    """Mean dB where every size between the levels could be had."""
    shown = [
        float(np.interp(math.log(b), np.log(s[::-1]), q[::-1])) for s, q, b in zip(sizes, quality, budgets, strict=True)
    ]
    return float(np.mean(shown))


def greedy(sizes: NDArray[np.float64], quality: NDArray[np.float64], budgets: NDArray[np.float64]) -> float:
    """Mean dB of the best level that fits, frame by frame, by the player's own search."""
    total = 0.0
    for row, shown, budget in zip(sizes, quality, budgets, strict=True):
        options = tuple(Option(j, int(size), float(q), 0.0) for j, (size, q) in enumerate(zip(row, shown, strict=True)))
        total += float(shown[select(Ladder(options), budget).index])
    return total / len(sizes)


def relaxed(sizes: NDArray[np.float64], quality: NDArray[np.float64], budgets: NDArray[np.float64]) -> float:
    """Mean dB of the linear relaxation of the paper's programme, each frame at the larger level's smaller neighbour."""
    shares, _ = paper_programme(sizes, quality, budgets, integer=False)
    last = [int(np.flatnonzero(row > 1e-6)[-1]) for row in shares]  # of the one or two that are mixed, the smaller
    return float(np.mean([quality[t, j] for t, j in enumerate(last)]))

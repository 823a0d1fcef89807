"""Choices of the policies in sessions over a link whose rate wanders: regression vectors, made by the policies.

A state whose choice hangs on the last digits of a number is left out, so that another order of sums is right, too.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from airgs_codec.play.offers import NONE
from airgs_codec.play.policies.mpc import discounted_throughput
from airgs_codec.play.policies.named import ADAPTIVE
from airgs_codec.play.policies.state import estimate_throughput
from tests.makers.vectors.text import Table, plain
from tests.support.offers import NumberOffers, Numbers
from tests.support.policy_states import State, choices, player_state

KEPT = 3  # states of every session
REMEMBERED = 6
TINY = 1e-9


@dataclass(frozen=True, slots=True)
class Shape:
    name: str
    groups: int
    segments: int  # of each group
    qualities: int
    levels: int
    tiers: int
    seconds: float  # of a segment


SHAPES = (
    Shape("short groups", 4, 1, 2, 3, 2, 0.5),
    Shape("long groups", 2, 6, 2, 4, 3, 1.0),
    Shape("one rung", 3, 2, 1, 1, 1, 0.75),
)


def make_offer(shape: Shape, rng: np.random.Generator) -> Numbers:
    """Sizes and qualities that mostly fall from rung to rung, as measured ones do."""
    tiers = [max(1, shape.tiers - j) for j in range(shape.levels)]
    levels = [{"tiers": tiers[j], "pruned": round(j / max(1, shape.levels), 2)} for j in range(shape.levels)]
    groups = [_keys(shape, rng) for _ in range(shape.groups)]
    segments = [_segment(g, shape, rng) for g in range(shape.groups) for _ in range(shape.segments)]
    return {"name": shape.name, "levels": levels, "groups": groups, "segments": segments}


def _keys(shape: Shape, rng: np.random.Generator) -> list[list[int]]:
    """Q x T wire bytes; a tier may have no rows."""
    sizes = rng.uniform(8e3, 4e4, shape.tiers) * (rng.uniform(size=shape.tiers) > 0.1)
    return [[int(size * 0.6**q) for size in sizes] for q in range(shape.qualities)]


def _segment(group: int, shape: Shape, rng: np.random.Generator) -> Numbers:
    """Quality may fall off a cliff, from the third level on or later."""
    most = rng.uniform(2e4, 9e4) * shape.seconds
    sizes = [int(most * 0.55**j * rng.uniform(0.9, 1.1)) for j in range(shape.levels)]
    if rng.uniform() < 0.15:
        sizes[-1] = 0  # nothing to fetch
    best, cliff = rng.uniform(33, 42), rng.integers(2, 6)
    falls = [1.6 * j + 5.0 * (j >= cliff) for j in range(shape.levels)]
    psnr = [
        [round(best - fall - 0.8 * q + rng.uniform(-0.4, 0.4), 2) for q in range(shape.qualities)] for fall in falls
    ]
    return {"group": group, "seconds": shape.seconds, "state_bytes": sizes, "psnr": psnr}


def session(offers: NumberOffers, driver: str, limit_s: float, rng: np.random.Generator) -> Iterator[State]:
    """The states of one session: as a player meets them that fetches one segment after the other."""
    now_s = deadline_s = 0.5
    history: list[list[Any]] = []
    shown: float | None = None
    rate = float(np.median([size for offer in offers.segments for size in offer.sizes(NONE)])) * 8
    rate *= rng.uniform(0.5, 2.0) / offers.segments[0].seconds
    decoded: dict[int, int] = {}
    end = max(2 * len(offers.segments), 16)
    for position in range(end):
        offer = offers.at(position)
        if offer.starts_group:
            decoded = {}
        lost = rng.integers(0, len(offer.rungs)) if rng.uniform() < 0.15 else 0
        missing = rng.permutation(len(offer.rungs))[:lost].tolist()
        state: State = {
            "position": position,
            "end": end,
            "decoded": [decoded.get(q, 0) for q in range(offers.qualities)],
            "unavailable": sorted(missing),
            "now_s": round(now_s, 6),
            "deadline_s": round(deadline_s, 6),
            "buffer_limit_s": limit_s,
            "request_latency_s": round(float(rng.uniform(0, 0.1)), 4),
            "shown_quality": shown,
            "history": history[-REMEMBERED:],
        }
        yield state
        rung, _, size = choices(offers, state)[driver]
        rate *= float(np.exp(rng.normal(0, 0.4)))
        took_s = round(max(size * 8 / rate, 1e-3), 6)
        history.append([size, took_s] if size else [350, took_s])
        now_s += took_s + state["request_latency_s"]
        deadline_s = max(deadline_s, now_s) + offer.seconds
        now_s = max(now_s, deadline_s - limit_s)
        chosen = offer.rungs[rung]
        decoded[chosen.quality] = max(decoded.get(chosen.quality, 0), offers.tiers[chosen.level])
        shown = chosen.psnr


def settled(offers: NumberOffers, state: State) -> bool:
    """Whether all choices stay the same when measured times change by the least bit."""
    nudged = [
        {**state, "history": [[size, seconds * (1 + sign * TINY)] for size, seconds in state["history"]]}
        | {"deadline_s": state["deadline_s"] + sign * TINY}
        for sign in (-1, 1)
    ]
    return all(choices(offers, other) == choices(offers, state) for other in nudged)


def table() -> Table:
    """Offers; states of players of an offer, with the estimates and the choice of every policy."""
    rng = np.random.default_rng(21)
    offers = [make_offer(shape, rng) for shape in SHAPES]
    states = []
    for number, numbers in enumerate(offers):
        offer = NumberOffers(numbers)
        for driver in (name for name in ADAPTIVE if not name.endswith("no-cliff")):
            for limit_s in (2.7, 10.0):
                met = [state for state in session(offer, driver, limit_s, rng) if settled(offer, state)]
                places = {0, *rng.choice(len(met), KEPT, replace=False).tolist()}
                states += [_answered(number, offer, met[place]) for place in sorted(places)]
    return {"offers": [dict(numbers) for numbers in offers], "states": states}


def _answered(number: int, offer: NumberOffers, state: State) -> dict[str, Any]:
    history = player_state(offer, state).history
    estimates = {"throughput": estimate_throughput(history), "discounted": discounted_throughput(history)}
    answers = {"estimates": {name: plain(value) for name, value in estimates.items()}, "choices": choices(offer, state)}
    return {"offer": number, **state, **answers}

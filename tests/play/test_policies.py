"""Policies: what each must do with a state that can be read, and what none may do.

Of Algorithm 1 of the paper the cases that it leaves undefined, by their numbers, and what must hold whatever comes.
"""

import itertools
import json
import math
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from airgs_codec.play.ladder import Option, build_ladder, frame_budget, saved_shares, select, select_literal
from airgs_codec.play.policies import upcoming_horizon
from tests.faces import NAMES, NONE, ConfigError, Decision, Download, Offers, PlayerState, make_policy
from tests.support.manifests import keyframes, link, tiny_manifest

OFFERS = Offers(tiny_manifest(), header_bytes=0)
FLAT = Offers(tiny_manifest(psnr=((40.0, 39.9), (39.8, 39.7), (39.6, 39.5))), header_bytes=0)
STALL_DB, SWITCH_DB, LOW_BUFFER_DB, RESERVE_S = 20.0, 0.25, 1.0, 3.0  # what the controller holds against a second
TABLE = json.loads(Path(__file__).with_name("ladder.json").read_text())  # cases that the browser's player reads, too
NOTHING_FITS = "nothing fits 10 B, taking the smallest"
NONE_FIT = Decision(1, False, "nothing fits 0 B, taking the smallest", 100)
drawn = st.tuples(st.integers(0, 10_000), st.floats(0, 120) | st.just(math.inf))
points = st.lists(drawn, min_size=1, max_size=12).map(lambda rows: [Option(i, *p, 0.1 * i) for i, p in enumerate(rows)])


def state(rate=8e4, buffer_s=0.0, *, offers=OFFERS, position=0, end=20, held=NONE, shown=None, rtt=0.0, limit=10.0):
    """A player that measured `rate` and has `buffer_s` of media at hand."""
    offer = offers.offer(position % 2)
    held = frozenset((offer.group, *key[1:]) for key in held)

    def upcoming():
        for p in range(position, end):
            yield offers.offer(p % 2), held if p // 2 == position // 2 else NONE

    return PlayerState(
        position=position, offer=offer, upcoming=upcoming, decoded=held, options=offer.options(held), now_s=100.0,
        deadline_s=100.0 + buffer_s, buffer_limit_s=limit, request_latency_s=rtt, shown_quality=shown,
        history=(Download(max(1, round(rate / 8)), 1.0),) * 4 if rate else (), pipelined=True,
    )  # fmt: skip


def choose(policy, some, over=None):
    return make_policy(policy, OFFERS, over or link([1e6])).choose(some)


def rung(policy, some, over=None):
    return OFFERS.names[choose(policy, some, over).index]


def best_total(s, rate, first=None):
    """The best total over every sequence of rungs, with the same sizes, changes and stalls."""
    best, offers = -math.inf, [offer for offer, _ in s.upcoming()]
    for sequence in np.ndindex(*(len(offer.rungs) for offer in offers)):
        if first is not None and sequence[0] != first:
            continue
        buffer, total, before = s.buffer_s, 0.0, s.shown_quality
        for offer, one in zip(offers, sequence, strict=True):
            took, quality = 8 * offer.sizes(NONE)[one] / rate, offer.psnr[one]
            total += quality - STALL_DB * max(0.0, took - buffer)
            total -= 0 if before is None else SWITCH_DB * abs(quality - before)
            buffer, before = min(max(0.0, buffer - took) + 1.0, s.buffer_limit_s), quality
            total -= LOW_BUFFER_DB * max(0.0, RESERVE_S - buffer)
        best = max(best, total)
    return best


@pytest.mark.parametrize("buffer_s", [0.0, 0.7, 2.0, 4.5])
@pytest.mark.parametrize("rate", [2.5e4, 3.6e4, 5e4])
def test_mpc_chooses_as_brute_force_does(buffer_s, rate):
    """Its grid rounds what a second of waiting costs between two of its points, 10 s / 79 apart, no more."""
    s = state(rate, buffer_s, end=4, shown=36.0)
    chosen = choose("robust-mpc", s).index
    assert best_total(s, rate, chosen) >= best_total(s, rate) - STALL_DB * 10 / 79 / 4


@pytest.mark.parametrize("shown", [None, 40.0, 34.5])
@pytest.mark.parametrize("buffer_s", [0.0, 0.6, 1.5, 3.0, 3.9, 9.5])
@pytest.mark.parametrize("rate", [1.2e4, 2.5e4, 3.6e4, 5e4, 9e4])
@pytest.mark.parametrize("offers", [OFFERS, FLAT])
def test_mpc_weighs_the_last_segment_exactly(rate, buffer_s, shown, offers):
    """Nothing follows, so nothing is rounded to the grid; a rung that is hardly better is not worth the reserve."""
    s = state(rate, buffer_s, offers=offers, end=1, shown=shown)
    chosen = choose("robust-mpc", s)
    assert best_total(s, rate, chosen.index) == pytest.approx(best_total(s, rate))
    assert chosen.fits is (8 * s.offer.sizes(NONE)[chosen.index] / rate <= buffer_s)


@pytest.mark.parametrize(("policy", "some", "over", "expected"), [
    ("fixed:2", state(), None, "Q0+L2"),
    ("fixed:Q1+L1", state(), None, "Q1+L1"),
    ("oracle-frame", state(1e3, 5.0), link([8e4]), "Q0+L0"),
    ("oracle-frame", state(8e9, 5.0), link([2e4]), "Q1+L2"),
    # It counts from the first byte: of a second 0.4 are latency, and the link must carry the rung in the other 0.6.
    ("oracle-frame", state(1e3, 5.0, rtt=0.4), link([8 * 3800 / 0.6 * 1.01]), "Q1+L0"),
    ("oracle-frame", state(1e3, 5.0, rtt=0.4), link([8 * 3800 / 0.6 * 0.99]), "Q1+L1"),
    # 50 kB before the outage are enough for four segments.
    ("oracle-lp", state(8e9, 3.0, end=4), link([8e5, 0.0], [0.0, 100.5], 1000), "Q0+L0"),
])  # fmt: skip
def test_what_is_chosen(policy, some, over, expected):
    assert rung(policy, some, over) == expected


@pytest.mark.parametrize("pipelined", [True, False])
def test_what_is_to_come_is_released_by_the_buffer_and_due_when_it_is_shown(pipelined):
    """10 kB a second; 1.5 s of buffer, room for 2; the first byte comes at 100.25 s."""
    s = replace(state(buffer_s=1.5, rtt=0.25, limit=2.0), pipelined=pipelined)
    slots, idle_bytes = upcoming_horizon(s, link([8e4], rtt=0.25))
    seconds = [(slot.released / 1e4, slot.capacity / 1e4) for slot in slots]
    assert seconds == [pytest.approx((100.75 + n, 101.5 + n)) for n in range(5)]  # up to two buffers after the first
    assert idle_bytes == pytest.approx(0 if pipelined else 2500)


def test_the_planned_rung_is_taken_or_what_its_bytes_buy():
    s, over = state(1e3, 3.0, end=4), link([8e5])
    planned = choose("oracle-lp", s, over)
    assert (OFFERS.names[planned.index], planned.size_bytes, planned.fits) == ("Q0+L0", 6300, True)
    assert planned.reason == "planned for 4 segments"
    left = replace(s, options=tuple(p for p in s.options if p.index != planned.index))
    assert rung("oracle-lp", left, over) == "Q0+L1"  # the best that fits in as many bytes
    nothing = choose("oracle-lp", state(1e3, 0.0, end=4), link([8.0]))
    assert OFFERS.names[nothing.index] == "Q1+L2" and not nothing.fits and "0 B" in nothing.reason
    tight = link([1.3e5, 0.0], [0.0, 100.5], 1000)  # 8 kB before an outage, for four segments
    assert rung("oracle-lp", state(8e9, 3.0, end=4), tight) != "Q0+L0"


@settings(max_examples=150)
@given(
    rates=st.lists(st.floats(1e2, 1e9), max_size=8), buffer_s=st.floats(-5, 12), position=st.integers(0, 19),
    held=st.sampled_from([NONE, keyframes(1), keyframes(2), keyframes(0, 2), keyframes(1, 2)]),
    name=st.sampled_from([n for n in NAMES if n != "oracle-lp"]),
)  # fmt: skip
def test_any_policy_answers_with_an_option(rates, buffer_s, held, name, position):
    history = tuple(Download(max(1, round(r / 8)), 1.0) for r in rates)
    s = replace(state(1.0, buffer_s, held=held, position=position), history=history)
    decision = choose(name, s, link([5e4]))
    assert decision.index in [p.index for p in s.options]
    assert decision.size_bytes == s.options[decision.index].size_bytes and decision.reason
    assert choose(name, s, link([5e4])) == decision


def test_an_oracle_needs_a_trace_and_what_policies_may_do_is_theirs():
    with pytest.raises(ConfigError, match="real connection"):
        make_policy("oracle-frame", OFFERS)
    may = {"paper": (True, True, True), "fixed:0": (False, False, False), "oracle-lp": (True, False, True)}
    made = {name: make_policy(name, OFFERS, link([1e6])) for name in may}
    assert {name: (it.may_abandon, it.may_replace, it.needs_quality) for name, it in made.items()} == may


def dense(*qualities: float, sizes: list[int] | None = None, saved: list[float] | None = None) -> list[Option]:
    """Levels 100 bytes apart that save 10 % more each, unless sizes or shares are given."""
    count = len(qualities)
    sizes, saved = sizes or [100 * (count - i) for i in range(count)], saved or [0.1 * i for i in range(count)]
    return [Option(i, *level) for i, level in enumerate(zip(sizes, qualities, saved, strict=True))]


@pytest.mark.parametrize("case", TABLE["ladders"], ids=lambda case: case["name"])
def test_undefined_cases_of_the_ladder(case):
    assert [p.index for p in build_ladder(dense(*map(float, case["qualities"])))] == case["kept"]


@pytest.mark.parametrize(("levels", "left"), [
    (dense(34, 32, 30, 28, 26), [0, 1, 2, 3, 4]),  # 5: a slow slide
    # From 40 % on, 1.2 dB for 10 % after 2 dB for 40 %: a cliff; the same levels 10 % apart have none.
    (dense(40.0, 38.0, 36.8, saved=saved_shares([1000, 600, 500])), [0, 1]),
    (dense(40.0, 38.0, 36.8), [0, 1, 2]),
    # 4 dB for 40 %, 2 dB for 10 %: 1.2 dB per 10 % so far, of which 2.3 is no cliff and 2.5 is one.
    (dense(40, 36, 34, 31.7, saved=[0, 0.4, 0.5, 0.6]), [0, 1, 2, 3]),
    (dense(40, 36, 34, 31.5, saved=[0, 0.4, 0.5, 0.6]), [0, 1, 2]),
    (dense(40, 39, 38, 37, sizes=[1000, 400, 700, 300]), [0, 1, 3]),  # 9: sizes that do not fall
])  # fmt: skip
def test_what_is_left_before_a_cliff(levels, left):
    assert [p.index for p in build_ladder(levels)] == left


@pytest.mark.parametrize(("qualities", "sizes", "budget", "expected"), [
    ((40, 39, 38, 37), [1000, 400, 700, 300], 500, Decision(1, True, "400 B fit 500 B", 400)),  # 9
    ((40, 39, 38, 20), None, 10, Decision(2, False, NOTHING_FITS, 200)),  # 7: with a cliff
    ((40, 39, 38), None, 10, Decision(2, False, NOTHING_FITS, 100)),  # 8: without one
    ((40, 39), [100, 0], -5, Decision(1, True, "0 B fit 0 B", 0)),  # 14: who sends nothing always fits
    *(((40, 39), None, budget, NONE_FIT) for budget in (math.nan, -1.0, -math.inf, 0.0)),  # 12: that are none
])  # fmt: skip
def test_the_best_that_fits_or_the_smallest(qualities, sizes, budget, expected):
    assert select(build_ladder(dense(*qualities, sizes=sizes)), budget) == expected


def test_units_13_bandwidths_that_are_none_12_and_shares_saved():
    """8 Mbit/s at 25 fps are 40,000 bytes a frame; half of it spent, less a header."""
    assert (frame_budget(8e6, 25), frame_budget(0.8, 0.1)) == pytest.approx((40_000, 1.0))
    assert [frame_budget(bandwidth, 30) for bandwidth in (math.nan, -1.0, 0.0)] == [0.0] * 3
    assert saved_shares([1000, 600, 500]) == pytest.approx([0, 0.4, 0.5])
    assert saved_shares([0, 0]) == [0, 0] and saved_shares([5, 9]) == [0, 0]


@pytest.mark.parametrize(("function", "arguments", "words"), [
    # 6
    *((partial(build_ladder, beta=beta), [dense(40, 39)], "more than 1") for beta in (1.0, 0.5, 0.0, math.nan)),
    (build_ladder, [[]], "at least one level"), (select_literal, [[], 10], "at least one level"),  # 10
    (build_ladder, [dense(40, math.nan)], "level 1"),  # 11
    (frame_budget, [1e6, 0.0], "frame rate"),  # 12
])  # fmt: skip
def test_what_is_refused(function, arguments, words):
    with pytest.raises(ConfigError, match=words):
        function(*arguments)


@pytest.mark.parametrize("case", TABLE["printed"], ids=lambda case: case["name"])
def test_algorithm_1_as_printed(case):
    """Level 0 of the largest budget wherever the search finds something: it looks for the lowest that fits."""
    levels = dense(*map(float, case["qualities"]), sizes=case.get("sizes"))
    budget, beta = float(case.get("budget", "inf")), float(case.get("beta", 2.0))
    assert select_literal(levels, budget, beta) == case["answer"]


@given(points=points, budget=st.floats(allow_nan=True, allow_infinity=True), beta=st.floats(1.01, 100))
def test_selection_is_total_and_keeps_its_word(points, budget, beta):
    ladder = build_ladder(points, beta=beta)
    decision = select(ladder, budget)
    assert decision.index in [p.index for p in ladder]
    usable = budget if budget > 0 else 0.0
    assert decision.fits == any(p.size_bytes <= usable for p in ladder)
    assert not decision.fits or decision.size_bytes <= usable
    assert decision.size_bytes == points[decision.index].size_bytes


@given(points=points, budget=st.integers(0, 12_000))
def test_without_a_cliff_ladders_fall_strictly_and_the_best_that_fits_is_taken(points, budget):
    """The paper's ILP separates by frame: the optimum is the best quality among what fits."""
    ladder = build_ladder(points, math.inf)
    for better, worse in itertools.pairwise(ladder):
        assert better.size_bytes > worse.size_bytes and better.quality > worse.quality
    for p in points:  # whatever was left out is beaten or equalled by something kept
        assert any(r.size_bytes <= p.size_bytes and r.quality >= min(p.quality, 100) for r in ladder)
    fitting = [min(p.quality, 100.0) for p in points if p.size_bytes <= budget]
    if fitting:
        assert min(points[select(ladder, budget).index].quality, 100.0) == max(fitting)


@given(qualities=st.lists(st.floats(20, 60), min_size=1, max_size=11, unique=True), budget=st.integers(0, 1200))
def test_as_printed_and_as_defined_agree_where_algorithm_1_is_defined(qualities, budget):
    """Falling quality and sizes, no cliff, something fits."""
    points = dense(*sorted(qualities, reverse=True))
    answer = select_literal(points, budget, beta=math.inf)
    decision = select(build_ladder(points, math.inf), budget)
    assert (answer is not None) == decision.fits
    assert answer is None or answer == decision.index

"""Policies: what each must do with a state that can be read, and what none may do."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from airgs_codec.play.policies.simple import upcoming_horizon
from tests.faces import NAMES, NONE, ConfigError, Download, Offers, PlayerState, make_policy
from tests.support.manifests import keys, link, tiny_manifest

OFFERS = Offers(tiny_manifest(), header_bytes=0)
OFFER = OFFERS.offer(0)
FLAT = Offers(tiny_manifest(psnr=((40.0, 39.9), (39.8, 39.7), (39.6, 39.5))), header_bytes=0)
STALL_DB, SWITCH_DB, LOW_BUFFER_DB, RESERVE_S = 20.0, 0.25, 1.0, 3.0  # what the controller holds against a second


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
    horizon = upcoming_horizon(s, link([8e4], rtt=0.25))
    seconds = [(slot.released / 1e4, slot.capacity / 1e4) for slot in horizon.slots]
    assert seconds == [pytest.approx((100.75 + n, 101.5 + n)) for n in range(5)]  # up to two buffers after the first
    assert horizon.idle_bytes == pytest.approx(0 if pipelined else 2500)


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
    held=st.sampled_from([NONE, keys(1), keys(2), keys(0, 2), keys(1, 2)]),
    name=st.sampled_from([n for n in NAMES if n != "oracle-lp"]),
)  # fmt: skip
def test_any_policy_answers_with_an_option(rates, buffer_s, held, name, position):
    history = tuple(Download(max(1, round(r / 8)), 1.0) for r in rates)
    s = replace(state(1.0, buffer_s, held=held, position=position), history=history)
    decision = choose(name, s, link([5e4]))
    assert decision.index in [p.index for p in s.options]
    assert decision.size_bytes == s.options[decision.index].size_bytes and decision.reason
    assert choose(name, s, link([5e4])) == decision


@pytest.mark.parametrize("text", ["", "paper:1", "best", "fixed", *map("fixed:{}".format, ("", 3, -1, 1.5, "Q2+L0"))])
def test_unknown_policies(text):
    with pytest.raises(ConfigError, match="expected paper"):
        make_policy(text, OFFERS, link([1e6]))


def test_an_oracle_needs_a_trace_and_what_policies_may_do_is_theirs():
    with pytest.raises(ConfigError, match="real connection"):
        make_policy("oracle-frame", OFFERS)
    may = {"paper": (True, True, True), "fixed:0": (False, False, False), "oracle-lp": (True, False, True)}
    made = {name: make_policy(name, OFFERS, link([1e6])) for name in may}
    assert {name: (it.may_abandon, it.may_replace, it.needs_quality) for name, it in made.items()} == may

"""Policies: what each must do with a state that can be read, and what none may do."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from airgs_codec.errors import ConfigError
from airgs_codec.play.offers import NONE, Offers
from airgs_codec.play.policies.mpc import (
    GRID_POINTS,
    LOW_BUFFER_DB,
    SWITCH_DB,
    Model,
    choose_robust_mpc,
    discounted_throughput,
)
from airgs_codec.play.policies.named import NAMES, make_policy
from airgs_codec.play.policies.oracle import choose_oracle_frame, choose_oracle_lp, upcoming_horizon
from airgs_codec.play.policies.paper import (
    choose_paper,
    choose_paper_literal,
    choose_paper_literal_no_cliff,
    choose_paper_no_cliff,
)
from airgs_codec.play.policies.simple import choose_bola, choose_throughput
from airgs_codec.play.policies.state import (
    RESERVE_S,
    SAFETY,
    STALL_DB,
    Download,
    PlayerState,
    before_cliff,
    budget_bytes,
    estimate_throughput,
    full_ladder,
)
from airgs_codec.play.trace import Link, Trace
from tests.support.manifests import keys, tiny_manifest

OFFERS = Offers(tiny_manifest(), header_bytes=0)
OFFER = OFFERS.offer(0)
FLAT = Offers(tiny_manifest(psnr=((40.0, 39.9), (39.8, 39.7), (39.6, 39.5))), header_bytes=0)


def constant(rate, rtt=0.0):
    return Link(Trace("t", np.zeros(1), np.array([float(rate)]), 1000.0), rtt)


def state(rate=8e4, buffer_s=0.0, *, offers=OFFERS, position=0, end=20, held=NONE, shown=None, rtt=0.0, limit=10.0):
    """A player that measured `rate` and has `buffer_s` of media at hand."""
    offer = offers.offer(position % 2)
    held = frozenset((offer.group, *key[1:]) for key in held)

    def upcoming():
        for p in range(position, end):
            yield offers.offer(p % 2), held if p // 2 == position // 2 else NONE

    return PlayerState(
        position=position,
        offer=offer,
        upcoming=upcoming,
        decoded=held,
        options=offer.options(held),
        now_s=100.0,
        deadline_s=100.0 + buffer_s,
        buffer_limit_s=limit,
        request_latency_s=rtt,
        shown_quality=shown,
        history=(Download(max(1, round(rate / 8)), 1.0),) * 4 if rate else (),
        pipelined=True,
    )


def names(decision):
    return OFFERS.names[decision.index]


def test_no_drop_is_a_cliff_to_the_whole_ladder():
    steep = Offers(tiny_manifest(psnr=((90.0, 36.0), (20.0, 15.0), (4.0, 2.0))), header_bytes=0).offer(0)
    s = replace(state(), offer=steep, options=steep.options(NONE))
    assert [p.quality for p in full_ladder(s).options] == [90.0, 36.0, 15.0, 2.0]
    assert len(before_cliff(s).options) < 4


def test_options_are_what_is_missing():
    sizes = dict(zip(OFFERS.names, OFFER.sizes(NONE), strict=True))
    assert sizes["Q0+L0"] == 3000 + 100 + 1000 + 100 + 2000 + 100
    assert sizes["Q1+L2"] == 1000 + 100 + 500 + 100 + 500 + 100
    held = dict(zip(OFFERS.names, OFFER.sizes(keys(2)), strict=True))
    assert held["Q0+L0"] == 2100 and held["Q1+L2"] == sizes["Q1+L2"]
    assert dict(zip(OFFERS.names, OFFER.sizes(keys(1)), strict=True))["Q0+L1"] == 1100 + 1100
    within = replace(OFFER, starts_group=False)
    assert within.bytes_after(OFFER, NONE)[0].tolist() == OFFER.sizes(keys(2))
    assert OFFER.bytes_after(OFFER, NONE).tolist() == [OFFER.sizes(NONE)]


def test_paper_spends_a_segments_time_or_half_the_buffer_15():
    assert budget_bytes(state(8e6, 0.0)) == pytest.approx(0.9 * 1e6)
    assert budget_bytes(state(8e6, 10.0, rtt=0.1)) == pytest.approx(0.9 * 1e6 * 4.9)
    assert names(choose_paper(state(8e4))) == "Q0+L0"  # 9000 B for 6300
    assert names(choose_paper(state(4e4))) == "Q1+L0"  # 4500 B: 3800, 36 dB
    assert not choose_paper(state(8e3)).fits


def test_the_cliff_bounds_what_paper_takes():
    """L2 has 34 dB where L1 has 38 for twice its bytes: it is past the cliff, in both key qualities."""
    poor = state(8e3, 0.0)
    assert names(choose_paper_no_cliff(poor)) == "Q1+L2" and names(choose_paper(poor)) == "Q1+L1"
    assert choose_paper(state(8e4)) == choose_paper_no_cliff(state(8e4))
    left = replace(poor, options=tuple(p for p in poor.options if p.index % 3 == 2))
    assert names(choose_paper(left)) == "Q1+L2"  # where no other can be had
    gentle = Offers(tiny_manifest(psnr=((40.0, 36.0), (38.0, 35.0), (37.0, 32.0))), header_bytes=0)
    assert names(choose_paper(state(8e3, 0.0, offers=gentle))) == "Q1+L2"


def test_the_cliff_is_the_segments_own_whatever_is_decoded():
    for held in (NONE, keys(2), keys(0, 2)):
        assert {p.index % 3 for p in before_cliff(state(held=held)).options} == {0, 1}


def test_throughput_does_not_look_at_the_buffer():
    assert choose_throughput(state(4e4, 0.0)).index == choose_throughput(state(4e4, 9.0)).index


@pytest.mark.parametrize("seconds", [1.0, 2.0])
def test_throughput_fills_its_share_of_the_segments_own_time(seconds):
    """Q1+L0 has 3800 B with its keys: it is taken from the rate on at which SAFETY of its seconds carry that."""
    edge = 8 * 3800 / (SAFETY * seconds)
    for rate, wanted in ((edge * 1.01, "Q1+L0"), (edge * 0.99, "Q1+L1")):
        s = state(rate)
        assert names(choose_throughput(replace(s, offer=replace(s.offer, seconds=seconds)))) == wanted


@pytest.mark.parametrize("seconds", [1.0, 2.0])
def test_paper_literal_has_the_bytes_of_the_segments_time_and_no_more(seconds):
    s = state(8 * 5300 / seconds)
    chosen = choose_paper_literal(replace(s, offer=replace(s.offer, seconds=seconds)))
    assert names(chosen) == "Q0+L1" and chosen.fits and chosen.reason == "Algorithm 1 for 5300 B"
    assert chosen.size_bytes == 5300
    rich = state(8 * 5300)
    coarse = replace(rich, options=tuple(p for p in rich.options if OFFER.rungs[p.index].quality == 1))
    assert names(choose_paper_literal(coarse)) == "Q1+L0"  # where no rung has the finest keys


def test_paper_literal_stops_at_its_cliff_and_its_search_alone_does_not():
    steep = Offers(tiny_manifest(psnr=((40.0, 36.0), (39.0, 35.0), (30.0, 29.0))), header_bytes=0)
    poor = state(8e3, offers=steep)
    assert choose_paper_literal(poor).reason == "Algorithm 1 for 1000 B"
    assert choose_paper_literal_no_cliff(poor).reason == "Algorithm 1 leaves it undefined"


def test_paper_literal_knows_levels_alone():
    assert names(choose_paper_literal(state(8e4))) == "Q0+L0"
    poor = choose_paper_literal(state(8e3))
    assert names(poor) == "Q0+L2" and not poor.fits
    none = choose_paper_literal_no_cliff(state(8e3))
    assert names(none) == "Q0+L2" and none.reason == "Algorithm 1 leaves it undefined"


def test_bola_rises_with_the_buffer_and_leaves_the_smallest_rung_at_its_reserve():
    choices = [choose_bola(state(8e4, b, limit=20.0)) for b in (0.0, 2.9, 10.0, 18.9)]
    qualities = [OFFER.psnr[d.index] for d in choices]
    assert qualities == sorted(qualities)
    assert names(choices[0]) == names(choices[1]) == "Q1+L2" and names(choices[-1]) == "Q0+L0"
    assert {choose_bola(state(r, 10.0)).index for r in (1e3, 1e9)} == {choose_bola(state(1e5, 10.0)).index}


@pytest.mark.parametrize("limit_s", [4.0, 20.0])
@pytest.mark.parametrize("buffer_s", [0.0, 0.9, 1.1, 2.9, 3.5, 6.0, 9.0, 13.0, 17.0, 18.95, 25.0])
def test_bola_scores_are_those_of_its_two_conditions(buffer_s, limit_s):
    """V and g solve: the best rung scores 0 at the limit; at the reserve the smallest scores as the next one does."""
    options = sorted(full_ladder(state()).options, key=lambda p: -p.size_bytes)
    sizes = np.array([p.size_bytes for p in options], float)
    utility = np.array([(p.quality - options[-1].quality) * np.log(10) / 20 for p in options])
    limit = limit_s - 1.0
    reserve = min(RESERVE_S, limit / 3)
    ways = []
    for u, size in zip(utility[:-1], sizes[:-1], strict=True):
        # v u0 + w = limit; (w - reserve) / smallest = (v u + w - reserve) / size, of v and w = v g
        left = [[utility[0], 1.0], [u / size, 1 / size - 1 / sizes[-1]]]
        v, w = np.linalg.solve(left, [limit, reserve * (1 / size - 1 / sizes[-1])])
        ways.append((v * utility + w - reserve) / sizes)
        ways[-1] = (ways[-1].argmax() == len(sizes) - 1 or np.isclose(ways[-1].max(), ways[-1][-1]), v, w)
    v, w = next((v, w) for holds, v, w in ways if holds)
    scores = (v * utility + w - buffer_s) / sizes
    wanted = options[0 if scores.max() <= 0 else int(scores.argmax())]
    chosen = choose_bola(state(8e4, buffer_s, limit=limit_s))
    assert (chosen.index, chosen.size_bytes, chosen.fits) == (wanted.index, wanted.size_bytes, True)
    assert chosen.reason == f"buffer {buffer_s:.2f} s"


def test_bola_takes_the_only_rung():
    s = state()
    alone = Offers(tiny_manifest(key_bytes=((3000,),), state_bytes=(2000,), psnr=((40.0,),)), header_bytes=0)
    chosen = choose_bola(replace(s, offer=alone.offer(0), options=alone.offer(0).options(NONE)))
    assert (chosen.index, chosen.fits, chosen.reason, chosen.size_bytes) == (0, True, "one rung", 3000 + 100 + 2100)


def test_mpc_is_careful_without_a_buffer_and_generous_with_one():
    slow = 3.4e4  # 4250 B/s: Q0+L0 takes 1.5 s, Q1+L2 0.5 s
    assert names(choose_robust_mpc(state(slow, 0.0))) != "Q0+L0"
    assert names(choose_robust_mpc(state(slow, 9.0))) == "Q0+L0"
    assert names(choose_robust_mpc(state(8e6, 0.0))) == "Q0+L0"
    nothing = choose_robust_mpc(state(0))
    assert names(nothing) == "Q1+L2" and not nothing.fits


def best_total(s, rate, horizon, first=None):
    """The best total over every sequence of rungs, with the same sizes, changes and stalls."""
    best = -math.inf
    for sequence in np.ndindex(*(len(OFFER.rungs),) * horizon):
        if first is not None and sequence[0] != first:
            continue
        buffer, total, before = s.buffer_s, 0.0, s.shown_quality
        for i, rung in enumerate(sequence):
            offer = OFFERS.offer((s.position + i) % 2)
            took = 8 * offer.sizes(NONE)[rung] / rate
            quality = offer.psnr[rung]
            total += quality - STALL_DB * max(0.0, took - buffer) - SWITCH_DB * abs(quality - before)
            buffer, before = min(max(0.0, buffer - took) + 1.0, s.buffer_limit_s), quality
            total -= LOW_BUFFER_DB * max(0.0, RESERVE_S - buffer)
        best = max(best, total)
    return best


@pytest.mark.parametrize("buffer_s", [0.0, 0.7, 2.0, 4.5])
@pytest.mark.parametrize("rate", [2.5e4, 3.6e4, 5e4])
def test_mpc_chooses_as_brute_force_does(buffer_s, rate):
    """Its grid rounds what a second of waiting costs between two of its points, 10 s / 79 apart, no more."""
    s = state(rate, buffer_s, end=4, shown=36.0)
    assert best_total(s, rate, 4, choose_robust_mpc(s).index) >= best_total(s, rate, 4) - STALL_DB * 10 / 79 / 4


@pytest.mark.parametrize("shown", [None, 40.0, 34.5])
@pytest.mark.parametrize("buffer_s", [0.0, 0.6, 1.5, 3.0, 3.9, 9.5])
@pytest.mark.parametrize("rate", [1.2e4, 2.5e4, 3.6e4, 5e4, 9e4])
@pytest.mark.parametrize("offers", [OFFERS, FLAT])
def test_mpc_weighs_the_last_segment_exactly(rate, buffer_s, shown, offers):
    """Nothing follows, so nothing is rounded to the grid; a rung that is hardly better is not worth the reserve."""
    s, offer = state(rate, buffer_s, offers=offers, end=1, shown=shown), offers.offer(0)
    took = [8 * size / rate for size in offer.sizes(NONE)]
    left = [min(max(buffer_s - t, 0) + 1, 10.0) for t in took]
    totals = [
        quality - STALL_DB * max(t - buffer_s, 0) - SWITCH_DB * abs(quality - (quality if shown is None else shown))
        - LOW_BUFFER_DB * max(RESERVE_S - after, 0)
        for quality, t, after in zip(offer.psnr, took, left, strict=True)
    ]  # fmt: skip
    chosen = choose_robust_mpc(s)
    assert totals[chosen.index] == pytest.approx(max(totals))
    assert chosen.fits is (took[chosen.index] <= buffer_s)


def test_a_step_of_mpc_adds_what_follows_between_the_points_of_its_grid():
    """Segments of half a second; what follows is known for each rung at each buffer of the grid."""
    limit, seconds = 6.0, 0.5
    grid_s, value = np.linspace(0.0, limit, GRID_POINTS), np.random.default_rng(0).normal(size=(2, GRID_POINTS))
    sizes, quality, before = np.array([[200, 50]]), np.array([40.0, 36.0]), np.array([40.0, 30.0])
    model = Model(8e3, 0.01, limit, grid_s)
    found = model.value_before(sizes, quality, before, seconds, value)
    assert model.download_s(np.array([0, 1, 50])).tolist() == pytest.approx([0, 0.011, 0.06])

    def total(rung, before_it, buffer_s):
        left_s = min(max(buffer_s - (0.21, 0.06)[rung], 0) + seconds, limit)
        change, short = abs(quality[rung] - before_it), max(RESERVE_S - left_s, 0)
        worth = seconds * (quality[rung] - SWITCH_DB * change - LOW_BUFFER_DB * short)
        return worth - STALL_DB * max((0.21, 0.06)[rung] - buffer_s, 0) + np.interp(left_s, grid_s, value[rung])

    expected = [[max(total(0, b, g), total(1, b, g)) for g in grid_s] for b in before]
    np.testing.assert_allclose(found, expected)


def test_mpc_says_what_it_counts_on():
    assert choose_robust_mpc(state(8e4, 1.5)).reason == "0.08 Mbit/s, buffer 1.50 s, 8 segments ahead"
    assert choose_robust_mpc(state(2e6, 0.0, end=3)).reason == "2.00 Mbit/s, buffer 0.00 s, 3 segments ahead"
    short = Offers(tiny_manifest(fps=(20, 1)), header_bytes=0)  # segments of half a second: 16 in its eight seconds
    assert choose_robust_mpc(state(8e4, 1.5, offers=short)).reason.endswith(", 12 segments ahead")


def test_a_step_of_mpc_weighs_quality_stalls_changes_and_the_reserve():
    """Two rungs of 1 s, at 1000 B/s 2 s and 0.5 s to fetch, of 40 and 36 dB, after either of two; nothing follows."""
    grid_s = np.array([0.0, 1.0, 2.5, RESERVE_S + 3])
    sizes, quality, before = np.array([[2000, 500]]), np.array([40.0, 36.0]), np.array([40.0, 30.0])
    found = Model(8e3, 0.0, grid_s[-1], grid_s).value_before(sizes, quality, before, 1.0, np.zeros((2, 80)))

    def total(took_s, shown, before_it, buffer_s):
        left_s = min(max(buffer_s - took_s, 0) + 1, grid_s[-1])
        waited = STALL_DB * max(took_s - buffer_s, 0) + LOW_BUFFER_DB * max(RESERVE_S - left_s, 0)
        return shown - waited - SWITCH_DB * abs(shown - before_it)

    expected = [[max(total(2, 40, b, g), total(0.5, 36, b, g)) for g in grid_s] for b in before]
    np.testing.assert_allclose(found, expected)


def test_the_oracles_know_the_trace():
    outage = Link(Trace("t", np.array([0.0, 100.5]), np.array([8e5, 0.0]), 1000.0), 0.0)
    assert names(choose_oracle_frame(state(1e3, 5.0), constant(8e4))) == "Q0+L0"
    assert names(choose_oracle_frame(state(8e9, 5.0), constant(2e4))) == "Q1+L2"
    assert names(choose_oracle_lp(state(8e9, 3.0, end=4), outage)) == "Q0+L0"  # 50 kB before the outage are enough
    tight = Link(Trace("t", np.array([0.0, 100.5]), np.array([1.3e5, 0.0]), 1000.0), 0.0)
    assert names(choose_oracle_lp(state(8e9, 3.0, end=4), tight)) != "Q0+L0"  # 8 kB for four segments


def test_an_oracle_of_one_frame_counts_from_the_first_byte():
    """Of a second 0.4 are latency: the link must carry the rung in the other 0.6."""
    for rate, wanted in ((8 * 3800 / 0.6 * 1.01, "Q1+L0"), (8 * 3800 / 0.6 * 0.99, "Q1+L1")):
        assert names(choose_oracle_frame(state(1e3, 5.0, rtt=0.4), constant(rate))) == wanted


@pytest.mark.parametrize("pipelined", [True, False])
def test_what_is_to_come_is_released_by_the_buffer_and_due_when_it_is_shown(pipelined):
    """10 kB a second; 1.5 s of buffer, room for 2; the first byte comes at 100.25 s."""
    s = replace(state(buffer_s=1.5, rtt=0.25, limit=2.0), pipelined=pipelined)
    horizon = upcoming_horizon(s, constant(8e4, rtt=0.25))
    seconds = [(slot.released / 1e4, slot.capacity / 1e4) for slot in horizon.slots]
    assert seconds == [pytest.approx((100.75 + n, 101.5 + n)) for n in range(5)]  # up to two buffers after the first
    assert horizon.idle_bytes == pytest.approx(0 if pipelined else 2500)


def test_the_planned_rung_is_taken_or_what_its_bytes_buy():
    s = state(1e3, 3.0, end=4)
    planned = choose_oracle_lp(s, constant(8e5))
    assert (names(planned), planned.size_bytes, planned.fits) == ("Q0+L0", 6300, True)
    assert planned.reason == "planned for 4 segments"
    left = replace(s, options=tuple(p for p in s.options if p.index != planned.index))
    assert names(choose_oracle_lp(left, constant(8e5))) == "Q0+L1"  # the best that fits in as many bytes
    nothing = choose_oracle_lp(state(1e3, 0.0, end=4), constant(8.0))
    assert names(nothing) == "Q1+L2" and not nothing.fits and "0 B" in nothing.reason


@settings(max_examples=150)
@given(
    rates=st.lists(st.floats(1e2, 1e9), max_size=8),
    buffer_s=st.floats(-5, 12),
    held=st.sampled_from([NONE, keys(1), keys(2), keys(0, 2), keys(1, 2)]),
    name=st.sampled_from([n for n in NAMES if n != "oracle-lp"]),
    position=st.integers(0, 19),
)
def test_any_policy_answers_with_an_option(rates, buffer_s, held, name, position):
    s = state(1.0, buffer_s, held=held, position=position)
    history = tuple(Download(max(1, round(r / 8)), 1.0) for r in rates)
    s = PlayerState(**{f: getattr(s, f) for f in s.__dataclass_fields__} | {"history": history})
    decision = make_policy(name, OFFERS, constant(5e4)).choose(s)
    assert decision.index in [p.index for p in s.options]
    assert decision.size_bytes == s.options[decision.index].size_bytes and decision.reason
    again = make_policy(name, OFFERS, constant(5e4)).choose(s)
    assert again == decision


def test_the_estimate_is_the_smaller_average():
    assert estimate_throughput([]) == 0
    assert estimate_throughput([Download(1000, 1.0)]) == pytest.approx(8000)
    rising = [Download(1000, 5.0), Download(10_000, 5.0)]
    falling = rising[::-1]
    assert estimate_throughput(falling) < estimate_throughput(rising)
    assert 1600 < estimate_throughput(falling) < 16_000
    assert estimate_throughput([Download(1000, 1e-9)]) == pytest.approx(8e12)


def test_surprises_discount_the_estimate():
    steady = [Download(1000, 1.0)] * 5
    assert discounted_throughput([]) == 0
    assert discounted_throughput(steady) == pytest.approx(8000)
    halved = discounted_throughput([*steady, Download(500, 1.0)])
    assert halved == pytest.approx(3 / (1 / 8000 + 1 / 8000 + 1 / 4000) / 2)  # predicted 8000 for 4000: error 1
    assert discounted_throughput([*steady, Download(2000, 1.0)]) > 8000  # a pleasant one does not
    assert discounted_throughput([Download(1000, 1.0), Download(500, 1.0)]) == pytest.approx(16e3 / 3 / 2)


@pytest.mark.parametrize(
    "text", ["", "paper:1", "fixed", "fixed:", "fixed:3", "fixed:-1", "fixed:1.5", "best", "fixed:Q2+L0"]
)
def test_unknown_policies(text):
    with pytest.raises(ConfigError, match="expected paper"):
        make_policy(text, OFFERS, constant(1e6))


def test_a_policy_that_is_unknown_is_told_which_rungs_there_are():
    with pytest.raises(ConfigError) as raised:
        make_policy("fixed:Q1+L9", OFFERS, constant(1e6))
    listed = f"--policy: expected {', '.join(NAMES)}, fixed:0 … fixed:2 or fixed:Q1+L2, got 'fixed:Q1+L9'"
    assert str(raised.value) == listed


@pytest.mark.parametrize(("text", "rung"), [("fixed:2", "Q0+L2"), ("fixed:Q1+L1", "Q1+L1")])
def test_fixed_rungs(text, rung):
    assert names(make_policy(text, OFFERS, constant(1e6)).choose(state())) == rung


def test_an_oracle_needs_a_trace_and_what_policies_may_do_is_theirs():
    with pytest.raises(ConfigError, match="real connection"):
        make_policy("oracle-frame", OFFERS)
    paper, fixed, oracle = (make_policy(name, OFFERS, constant(1e6)) for name in ("paper", "fixed:0", "oracle-lp"))
    assert (paper.may_abandon, paper.may_replace, paper.needs_quality) == (True, True, True)
    assert (fixed.may_abandon, fixed.may_replace, fixed.needs_quality) == (False, False, False)
    assert (oracle.may_abandon, oracle.may_replace, oracle.needs_quality) == (True, False, True)

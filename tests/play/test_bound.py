"""Bounds: what can be worked out by hand, and that nothing beats them."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.faces import (
    NONE,
    ConfigError,
    Horizon,
    Link,
    Offers,
    SessionSettings,
    Slot,
    Trace,
    session_bound,
    simulate,
    solve_horizon,
)
from tests.support.manifests import keys, tiny_manifest

OFFERS = Offers(tiny_manifest(), header_bytes=0)


def horizon(*capacities, released=0.0, decoded=NONE, starts=None, offers=OFFERS):
    starts = [True] * len(capacities) if starts is None else starts
    slots = tuple(
        Slot(replace(offers.offer(i % 2), starts_group=o), released, float(c))
        for i, (c, o) in enumerate(zip(capacities, starts, strict=True))
    )
    return Horizon(slots, decoded)


def test_bytes_that_are_left_serve_later():
    """6300 B for the first, 3800 (36 dB) or 5300 (38 dB) for the second: both best only if the first leaves some."""
    exact = solve_horizon(horizon(6300, 11600), integer=True)
    assert exact is not None and exact.quality == pytest.approx((40 + 38) / 2)
    relaxed = solve_horizon(horizon(6300, 11500))  # shares of rungs, unless whole ones are asked for
    assert relaxed is not None and relaxed.rungs.max(axis=1).min() < 0.99


def test_what_is_decoded_is_so_in_the_loop_of_the_first_slot_alone():
    """A sequence of one segment: its keys are fetched again in the second loop."""
    first, again = (replace(OFFERS.offer(0), starts_group=starts) for starts in (False, True))
    for end, whole in ((2100.0 + 6300.0, True), (2100.0 + 6300.0 - 1, False)):
        both = Slot(first, 0.0, 2100.0), Slot(again, 0.0, end)
        best = solve_horizon(Horizon(both, keys(2)), integer=True)
        assert best is not None and (best.quality == pytest.approx(40.0)) is whole


def test_what_is_shown_longer_counts_for_more():
    """A second and then three: bytes for one best rung, and one that is 2 dB worse, go to the three."""
    offers = Offers(tiny_manifest(groups=(10, 30), fps=(10, 1)), header_bytes=0)
    assert [offers.seconds_at(position) for position in (0, 1)] == [1.0, 3.0]
    exact = solve_horizon(horizon(6300, 11600, offers=offers), integer=True)
    assert exact is not None and exact.quality == pytest.approx((38 * 1 + 40 * 3) / 4)
    assert exact.first_bytes == pytest.approx(5300)


def test_a_release_keeps_the_link_from_working_ahead():
    slots = (Slot(OFFERS.offer(0), 0.0, 6300.0), Slot(OFFERS.offer(1), 9000.0, 12000.0))
    best = solve_horizon(Horizon(slots), integer=True)
    assert best is not None and best.quality == pytest.approx((40 + 35) / 2)  # 3000 B after 9000: Q1+L1 has 2800


def test_too_late_for_the_smallest():
    assert solve_horizon(horizon(2000)) is None
    with pytest.raises(ConfigError, match="at least one slot"):
        solve_horizon(horizon())


def test_keys_are_paid_once_a_group():
    together = solve_horizon(horizon(6300, 8400, starts=[True, False]), integer=True)
    assert together is not None and together.quality == pytest.approx(40.0)
    apart = solve_horizon(horizon(6300, 8400), integer=True)
    assert apart is not None and apart.quality < 40
    with_keys = solve_horizon(horizon(2100, decoded=keys(2), starts=[False]), integer=True)
    assert with_keys is not None and with_keys.quality == pytest.approx(40.0)


def test_keys_that_are_not_needed_any_more_are_not_given_back():
    """Bytes for 38 dB and then the smallest state: not for 40 and coarser keys in place of those that were fetched."""
    quality = dict(zip(OFFERS.names, OFFERS.offer(1).psnr, strict=True))
    exact = solve_horizon(horizon(6300, 6300, starts=[True, False]), integer=True)
    assert exact is not None and exact.quality == pytest.approx((38 + quality["Q0+L2"]) / 2)


def test_of_a_quality_of_which_some_units_are_decoded_the_others_are_paid():
    first = frozenset({(0, 0, 0)})
    whole = solve_horizon(horizon(3200, decoded=first, starts=[False]), integer=True)
    assert whole is not None and whole.quality == pytest.approx(40.0) and whole.first_bytes == pytest.approx(3200)
    short = solve_horizon(horizon(3199, decoded=first, starts=[False]), integer=True)
    assert short is not None and short.quality < 40


def test_an_idle_link_costs_every_slot_but_the_first():
    """The release of the first slot says when its bytes begin; the wait before each later one is counted apart."""
    enough = solve_horizon(replace(horizon(6300, 12600 + 500), idle_bytes=500.0), integer=True)
    assert enough is not None and enough.quality == pytest.approx(40.0) and enough.first_bytes == pytest.approx(6300)
    short = solve_horizon(replace(horizon(6300, 12600), idle_bytes=500.0), integer=True)
    assert short is not None and short.quality < 40


@pytest.mark.parametrize("pipelined", [True, False])
def test_the_oracle_pays_only_round_trips_that_its_player_pays(pipelined):
    """A second of the best rung takes 6300 B, and keys of every group; the link carries 8 % more than that.

    A pipelined player keeps such a link busy in spite of round trips of 0.3 s, and the plan must count on it.
    """
    link = Link(Trace("t", np.zeros(1), np.array([1.08 * 8 * 6300.0]), 1000.0), rtt_s=0.3)
    rules = SessionSettings(loops=15, decode_frame_s=0.0, buffer_s=4.0, startup_s=2.0, pipelined=pipelined)
    log = simulate(OFFERS, link, "oracle-lp", rules)
    best = np.mean([shown.rung == 0 for shown in log.shown])
    assert log.metrics.stall_s < 0.1
    assert best > 0.9 if pipelined else best < 0.6


def test_rounding_of_media_time_does_not_delay_a_release():
    """25 segments of 0.4 s add up to a little more than the buffer of 10 s: the last of them waits for nothing."""
    c = Offers(tiny_manifest(fps=(25, 1)), header_bytes=0)
    assert np.cumsum([0.0, *[c.seconds_at(0), c.seconds_at(1)] * 13])[25] > 10.0
    trace = Trace("t", np.array([0.0, 4.0]), np.array([8 * 60000.0, 8 * 500.0]), 1000.0)
    log = simulate(c, trace, "paper", SessionSettings(loops=25, buffer_s=10.0))
    bound = session_bound(log)
    assert bound is not None and bound >= log.mean_quality - 1e-6


def test_a_rung_with_one_tier_does_not_pay_for_two():
    m = tiny_manifest(psnr=((40.0, 30.0), (38.0, 29.0), (34.0, 28.0)))
    core = replace(m, levels=[*m.levels[:2], replace(m.levels[2], tiers=1)])
    best = solve_horizon(horizon(3100 + 600, offers=Offers(core, 0)), integer=True)
    assert best is not None and best.rungs[0].argmax() == 2 and best.first_bytes == pytest.approx(3700)


capacities = st.lists(st.integers(2300, 9000), min_size=1, max_size=5).map(np.cumsum)


@settings(max_examples=60)
@given(capacities=capacities)
def test_the_relaxation_bounds_the_integers_which_equal_enumeration(capacities):
    relaxed, exact = (solve_horizon(horizon(*capacities), integer=i) for i in (False, True))
    assert relaxed is not None and exact is not None
    assert relaxed.quality >= exact.quality - 1e-6
    best = -math.inf
    for rungs in np.ndindex(*(len(OFFERS.rungs),) * len(capacities)):
        spent = np.cumsum([OFFERS.offer(i % 2).sizes(NONE)[r] for i, r in enumerate(rungs)])
        if (spent <= capacities).all():
            best = max(best, np.mean([OFFERS.offer(i % 2).psnr[r] for i, r in enumerate(rungs)]))
    assert exact.quality == pytest.approx(best, abs=1e-5)

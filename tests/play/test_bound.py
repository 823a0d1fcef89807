"""Bounds: what can be worked out by hand, that nothing beats them, and rates and sizes at their ends."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests import faces
from tests.faces import NONE, Offers, SessionSettings, Slot, simulate, solve_horizon
from tests.support.manifests import keeping, keyframes, link, play, tiny_manifest
from tools.lab.numerics.outcome import BOUNDED, EXACT, UNFIT
from tools.lab.numerics.plans import KINDS, judge_margin, offer, solved

OFFERS = Offers(tiny_manifest(), header_bytes=0)
LONGER = Offers(tiny_manifest(groups=(10, 30)), header_bytes=0)  # a second and then three
CORE = tiny_manifest(psnr=((40.0, 30.0), (38.0, 29.0), (34.0, 28.0)))
CORE = Offers(replace(CORE, levels=[*CORE.levels[:2], replace(CORE.levels[2], tiers=1)]), 0)
KEPT = Offers(keeping(tiny_manifest()), 0, 1000)
FOUR = Offers(keeping(keeping(tiny_manifest(groups=(10,) * 4)), 4), 0)  # the third group, between, stands by itself
FIRST = frozenset({(0, 0, 0)})  # the finest keyframes of the first tier
ONE_GROUP = [True, False]


def horizon(*capacities, released=None, decoded=NONE, starts=None, offers=OFFERS, at=None, idle=0.0):
    """Slots of these capacities, whose segments are those of a package by turns."""
    every = range(len(capacities))
    released, starts, at = released or [0.0] * len(every), starts or [True] * len(every), at or [i % 2 for i in every]
    slots = tuple(
        Slot(replace(offers.offer(position), starts_group=o), float(r), float(c))
        for position, r, c, o in zip(at, released, capacities, starts, strict=True)
    )
    return slots, decoded, idle


@pytest.mark.parametrize(("programme", "quality", "first_bytes"), [
    # 6300 B for the first, 3800 (36 dB) or 5300 (38 dB) for the second: both best only if the first leaves some.
    (horizon(6300, 11600), (40 + 38) / 2, None),
    (horizon(6300, 8400), (38 + 35) / 2, 2800),
    # Keyframes are paid once a group, also those of a quality of which some are decoded; a byte less is not enough.
    (horizon(6300, 8400, starts=ONE_GROUP), 40, 6300),
    (horizon(6300, 8399, starts=ONE_GROUP), (40 + 38) / 2, None),
    (horizon(2100, decoded=keyframes(2), starts=[False]), 40, 2100),
    (horizon(3200, decoded=FIRST, starts=[False]), 40, 3200),
    (horizon(3199, decoded=FIRST, starts=[False]), 38, 2200),
    # Bytes for 38 dB and then the smallest delta: not for 40 and coarser keyframes in place of those that were fetched.
    (horizon(6300, 6300, starts=ONE_GROUP), (38 + 34) / 2, None),
    # In a sequence of one segment, keyframes are fetched again in the second loop.
    (horizon(2100, 2100 + 6300, decoded=keyframes(2), starts=[False, True], at=[0, 0]), 40, 2100),
    (horizon(2100, 2100 + 6299, decoded=keyframes(2), starts=[False, True], at=[0, 0]), (40 + 38) / 2, None),
    # What is shown longer counts for more: bytes for one best rung, and one that is 2 dB worse, go to the three.
    (horizon(6300, 11600, offers=LONGER), (38 * 1 + 40 * 3) / 4, 5300),
    # A release keeps the link from working ahead: 3000 B after 9000 are enough for the 2800 of Q1+L1.
    (horizon(6300, 12000, released=[0, 9000]), (40 + 35) / 2, 6300),
    # The release of the first slot says when its bytes begin; the wait before each later one is counted apart.
    (horizon(6300, 12600 + 500, idle=500.0), 40, 6300),
    (horizon(6300, 12600, idle=500.0), (40 + 38) / 2, None),
    # A group that keeps rows of a base takes 3000 + 200 + 2100 B, and its base is paid for once, however far back.
    (horizon(6300, 11600, offers=KEPT), 40, 6300),
    (horizon(6300, 11599, offers=KEPT), (40 + 38) / 2, None),
    (horizon(9500, offers=KEPT, at=[1]), 40, 9500),
    (horizon(9499, offers=KEPT, at=[1]), 38, 8500),
    (horizon(5300, offers=KEPT, at=[1], decoded=keyframes(2)), 40, 5300),
    (horizon(5299, offers=KEPT, at=[1], decoded=keyframes(2)), 38, 4300),
    (horizon(9500, 15_800, 21_100, offers=FOUR, at=[1, 2, 3]), 40, 9500),
    (horizon(9500, 15_800, 21_099, offers=FOUR, at=[1, 2, 3]), (40 + 40 + 38) / 3, None),
    (horizon(6300, 15_800, offers=FOUR, at=[2, 3]), 40, 6300),  # nobody needed the base before
    (horizon(6300, 15_799, offers=FOUR, at=[2, 3]), (40 + 38) / 2, None),
    # A rung of the last level needs one tier, and does not pay for two.
    (horizon(3100 + 600, offers=CORE), 34, 3700),
])  # fmt: skip
def test_the_best_of_a_horizon(programme, quality, first_bytes):
    best = solve_horizon(*programme, integer=True)
    assert best is not None and best.quality == pytest.approx(quality)
    assert first_bytes is None or best.first_bytes == pytest.approx(first_bytes)


def test_another_quality_than_the_bases_needs_the_base_in_that_quality():
    q0, q1 = (KEPT.rungs.index((q, 0)) for q in (0, 1))
    sizes = KEPT.offer(1).sizes(keyframes(2))
    assert sizes[q0] == 3000 + 200 + 2100
    assert sizes[q1] == 1000 + 200 + (1000 + 500 + 200) + 2100
    batch = KEPT.offer(1).missing(q1, keyframes(2))
    assert batch.keyframes == (
        *("keyframe/T0/2.bin", "keyframe/T0/Q1/2.m4s", "keyframe/T0/1.bin", "keyframe/T0/Q1/1.m4s"),
        *("keyframe/T1/2.bin", "keyframe/T1/1.bin", "keyframe/T1/Q1/1.m4s"),
    )
    assert KEPT.wire_bytes(batch.files) == sizes[q1]


def test_what_has_no_schedule():
    relaxed = solve_horizon(*horizon(6300, 11500))  # shares of rungs, unless whole ones are asked for
    assert relaxed is not None and relaxed.rungs.max(axis=1).min() < 0.99
    assert solve_horizon(*horizon(2000)) is None
    with pytest.raises(faces.ConfigError, match="at least one slot"):
        solve_horizon(*horizon())


@pytest.mark.parametrize("pipelined", [True, False])
def test_the_oracle_pays_only_round_trips_that_its_player_pays(pipelined):
    """A second of the best rung takes 6300 B, and keyframes of every group; the link carries 8 % more than that.

    A pipelined player keeps such a link busy in spite of round trips of 0.3 s, and the plan must count on it.
    """
    rules = SessionSettings(loops=15, decode_frame_s=0.0, buffer_s=4.0, startup_s=2.0, pipelined=pipelined)
    log = simulate(OFFERS, link([1.08 * 8 * 6300.0], rtt=0.3), "oracle-lp", rules)
    best = np.mean([shown.rung == 0 for shown in log.shown])
    assert log.metrics.stall_s < 0.1
    assert best > 0.9 if pipelined else best < 0.6


def check_bound(log):
    bound = faces.session_bound(log)
    assert bound is not None and bound >= log.mean_quality - 1e-6


def test_rounding_of_media_time_does_not_delay_a_release():
    """25 segments of 0.4 s add up to a little more than the buffer of 10 s: the last of them waits for nothing."""
    c = Offers(tiny_manifest(fps=(25, 1)), header_bytes=0)
    assert np.cumsum([0.0, *[c.seconds_at(0), c.seconds_at(1)] * 13])[25] > 10.0
    over = link([8 * 60000.0, 8 * 500.0], [0, 4], 1000).trace
    check_bound(simulate(c, over, "paper", SessionSettings(loops=25, buffer_s=10.0)))


@given(st.lists(st.floats(2e4, 2e5), min_size=2, max_size=6), st.tuples(st.booleans(), st.booleans()))
@settings(max_examples=20)
def test_no_session_that_keeps_rows_beats_the_bound(rates, pictures):
    m = keeping(keeping(tiny_manifest(groups=(10, 10, 10, 10)), 2, 1, pictures), 4, 1, pictures)
    for policy, loops in itertools.product(("throughput", "robust-mpc", "oracle-lp", "fixed:Q1+L1"), (1, 2)):
        check_bound(play(m, link(rates), policy, loops=loops, replace=True, abandon=True))


@settings(max_examples=60)
@given(st.lists(st.integers(2300, 9000), min_size=1, max_size=5).map(np.cumsum))
def test_the_relaxation_bounds_the_integers_which_equal_enumeration(capacities):
    relaxed, exact = (solve_horizon(*horizon(*capacities), integer=i) for i in (False, True))
    assert relaxed is not None and exact is not None
    assert relaxed.quality >= exact.quality - 1e-6
    every = np.indices((len(OFFERS.rungs),) * len(capacities)).reshape(len(capacities), -1)  # a rung of each slot
    spent, shown = np.zeros(every.shape[1]), np.zeros(every.shape[1])
    fits = np.ones(every.shape[1], bool)
    for i, (rungs, capacity) in enumerate(zip(every, capacities, strict=True)):
        slot = OFFERS.offer(i % 2)
        spent += np.array(slot.sizes(NONE))[rungs]
        shown += slot.psnr[rungs] / len(capacities)
        fits &= spent <= capacity
    assert exact.quality == pytest.approx(shown[fits].max(), abs=1e-5)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("mbps", [1e-3, 1e-1, 1e1, 1e3, 1e6, 1e9])
def test_plans_are_feasible_or_there_are_none(kind, mbps):
    """`solved` compares what is spent with the capacities, and what is refused with the smallest rungs."""
    assert solved(kind, 1e6 * mbps)[0] in (EXACT, BOUNDED, UNFIT)


def test_links_that_carry_the_best_of_everything_or_just_a_session():
    for kind in KINDS[:4]:
        what, capacities = offer(kind, 1e12)
        assert (what.sizes.sum(axis=0)[0] <= capacities[0]).all()
        assert solved(kind, 1e12)[:2] == (EXACT, pytest.approx(0, abs=1e-6))
    assert judge_margin(1e-7, 1e5, tries=3)[0] == EXACT


def test_links_too_slow_for_a_day_and_rates_beyond_what_sums_hold_are_refused():
    for rate in (1e-300, 1e-30, 1e-9, 1e-3):
        with pytest.raises(faces.TransportError, match=r"t: \d+ bytes would take .* s, expected at most 86400 s"):
            simulate(OFFERS, link([rate], duration=1000), "robust-mpc", SessionSettings(loops=1))
    fastest = link([1e19], duration=1000)
    assert fastest.trace.mean_bps == pytest.approx(1e19)
    with pytest.raises(faces.TransportError, match="at most 1e"):
        link([2e19])
    check_bound(simulate(OFFERS, fastest, "oracle-lp", SessionSettings(loops=3)))

"""Plans and sessions where rates and sizes are at their ends."""

import math

import numpy as np
import pytest

from airgs_codec.play.trace import LONGEST_S, MOST_BPS
from tests.faces import Link, Offers, SessionSettings, Trace, TransportError, session_bound, simulate
from tests.support.manifests import tiny_manifest
from tools.lab.numerics.outcome import BOUNDED, EXACT, UNFIT
from tools.lab.numerics.plans import KINDS, judge_margin, offer, solved

OFFERS = Offers(tiny_manifest(), header_bytes=0)


def constant(rate_bps: float) -> Trace:
    return Trace("slow", np.zeros(1), np.array([rate_bps]), 1000.0)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("mbps", [1e-3, 1e-1, 1e1, 1e3, 1e6, 1e9])
def test_plans_are_feasible_or_there_are_none(kind: str, mbps: float) -> None:
    """`solved` compares what is spent with the capacities, and what is refused with the smallest rungs."""
    assert solved(kind, 1e6 * mbps)[0] in (EXACT, BOUNDED, UNFIT)


def test_the_fastest_link_carries_the_best_of_everything() -> None:
    for kind in KINDS[:4]:
        what, capacities = offer(kind, 1e12)
        assert (what.sizes.sum(axis=0)[0] <= capacities[0]).all()
        assert solved(kind, 1e12)[:2] == (EXACT, pytest.approx(0, abs=1e-6))


def test_a_link_that_just_carries_a_session_is_no_fault() -> None:
    assert judge_margin(1e-7, 1e5, tries=3)[0] == EXACT


@pytest.mark.parametrize("rate", [1e-300, 1e-30, 1e-9, 1e-3])
def test_a_link_too_slow_for_a_day_is_refused(rate: float) -> None:
    with pytest.raises(TransportError, match=r"slow: \d+ bytes would take .* s, expected at most 86400 s"):
        simulate(OFFERS, Link(constant(rate)), "robust-mpc", SessionSettings(loops=1))


def test_a_batch_of_just_under_a_day_arrives() -> None:
    link = Link(constant(8.0), rtt_s=0.0)
    assert link.arrival_s(LONGEST_S - 1, 0.0) == pytest.approx(LONGEST_S - 1)
    with pytest.raises(TransportError, match="expected at most"):
        link.arrival_s(LONGEST_S + 1, 0.0)


@pytest.mark.parametrize("rate", [1e-12, 1e-13, 3e-15, 7e-17])
def test_an_arrival_after_countless_rounds_is_not_an_error(rate: float) -> None:
    """A trace of a thousand seconds that is repeated until the rounding of its rounds exceeds it."""
    assert constant(rate).arrival_s(1e3, 0.0) == pytest.approx(8e3 / rate) or rate < 1e-15
    assert constant(rate).arrival_s(1e3, 0.0) <= math.inf


def test_rates_beyond_what_sums_hold_are_refused() -> None:
    assert constant(MOST_BPS).mean_bps == pytest.approx(MOST_BPS)
    with pytest.raises(TransportError, match="expected rates of at most"):
        constant(2 * MOST_BPS)
    log = simulate(OFFERS, Link(constant(MOST_BPS)), "oracle-lp", SessionSettings(loops=3))
    bound = session_bound(log)
    assert bound is not None and bound >= log.mean_quality - 1e-6

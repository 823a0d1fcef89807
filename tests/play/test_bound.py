"""Bounds: what can be worked out by hand, and that nothing beats them."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from airgs_codec.errors import ConfigError
from airgs_codec.play.bound import Horizon, Unit, paper_programme, solve_horizon
from airgs_codec.play.catalogue import Catalogue
from airgs_codec.play.ladder import Ladder, Option, select
from tests.support.manifests import tiny_manifest

CATALOGUE = Catalogue(tiny_manifest(), header_bytes=0)


def horizon(*capacities, released=0.0, held=None, opens=None, catalogue=CATALOGUE):
    """One unit for each capacity, segments in turn."""
    opens = [True] * len(capacities) if opens is None else opens
    units = tuple(Unit(i % 2, o, released, float(c)) for i, (c, o) in enumerate(zip(capacities, opens, strict=True)))
    return Horizon(catalogue, units, held or {})


def test_everything_fits():
    plan = solve_horizon(horizon(6300, 12600))
    assert plan is not None and plan.quality == pytest.approx(40.0) and plan.first_bytes == pytest.approx(6300)
    assert plan.rungs[:, 0] == pytest.approx([1, 1])


def test_bytes_that_are_left_serve_later():
    """6300 B for the first, 3800 (36 dB) or 5300 (38 dB) for the second: both best only if the first leaves some."""
    exact = solve_horizon(horizon(6300, 11600), integer=True)
    assert exact is not None and exact.quality == pytest.approx((40 + 38) / 2)
    per_frame, feasible = paper_programme([[6300, 5300, 3800]] * 2, [[40, 38, 36]] * 2, [6300, 5300])
    assert feasible.all() and per_frame == pytest.approx(78)


def test_a_release_keeps_the_link_from_working_ahead():
    units = (Unit(0, True, 0.0, 6300.0), Unit(1, True, 9000.0, 12000.0))
    plan = solve_horizon(Horizon(CATALOGUE, units, {}), integer=True)
    assert plan is not None and plan.quality == pytest.approx((40 + 35) / 2)  # 3000 B after 9000: Q1+L1 has 2800


def test_too_late_for_the_smallest():
    assert solve_horizon(horizon(2000)) is None
    with pytest.raises(ConfigError, match="at least one unit"):
        solve_horizon(horizon())


def test_keys_are_paid_once_a_group():
    together = solve_horizon(horizon(6300, 8400, opens=[True, False]), integer=True)
    assert together is not None and together.quality == pytest.approx(40.0)
    apart = solve_horizon(horizon(6300, 8400), integer=True)
    assert apart is not None and apart.quality < 40
    at_hand = solve_horizon(horizon(2100, held={0: 2}, opens=[False]), integer=True)
    assert at_hand is not None and at_hand.quality == pytest.approx(40.0)


def test_a_rung_with_one_tier_does_not_pay_for_two():
    m = tiny_manifest(psnr=((40.0, 30.0), (38.0, 29.0), (34.0, 28.0)))
    core = replace(m, levels=[*m.levels[:2], replace(m.levels[2], tiers=1)])
    plan = solve_horizon(horizon(3100 + 600, catalogue=Catalogue(core, 0)), integer=True)
    assert plan is not None and plan.rungs[0].argmax() == 2 and plan.first_bytes == pytest.approx(3700)


capacities = st.lists(st.integers(2300, 9000), min_size=1, max_size=5).map(np.cumsum)


@settings(deadline=None, max_examples=60)
@given(capacities=capacities)
def test_the_relaxation_bounds_the_integers_which_equal_enumeration(capacities):
    relaxed, exact = (solve_horizon(horizon(*capacities), integer=i) for i in (False, True))
    assert relaxed is not None and exact is not None
    assert relaxed.quality >= exact.quality - 1e-6
    best = -math.inf
    for rungs in np.ndindex(*(len(CATALOGUE.rungs),) * len(capacities)):
        spent = np.cumsum([CATALOGUE.bytes_from_scratch[i % 2][r] for i, r in enumerate(rungs)])
        if (spent <= capacities).all():
            best = max(best, np.mean([CATALOGUE.quality[i % 2][r] for i, r in enumerate(rungs)]))
    assert exact.quality == pytest.approx(best, abs=1e-5)


@settings(deadline=None, max_examples=40)
@given(
    frames=st.lists(
        st.lists(st.tuples(st.integers(0, 5000), st.floats(20, 60)), min_size=3, max_size=3), min_size=1, max_size=6
    ),
    budgets=st.lists(st.floats(0, 6000), min_size=6, max_size=6),
)
def test_the_papers_programme_separates_by_frame(frames, budgets):
    sizes = [[s for s, _ in levels] for levels in frames]
    qualities = [[q for _, q in levels] for levels in frames]
    total, feasible = paper_programme(sizes, qualities, budgets[: len(frames)])
    alone = 0.0
    for levels, budget, fits in zip(frames, budgets, feasible, strict=False):
        points = [Option(j, s, q, 0.1 * j) for j, (s, q) in enumerate(levels)]
        decision = select(Ladder.build(points, beta=math.inf, cliff_db=math.inf), budget)
        assert decision.fits == fits
        alone += qualities_of(levels, decision.index) if fits else 0.0
    assert total == pytest.approx(alone, abs=1e-6)


def qualities_of(levels, level):
    return levels[level][1]

"""A budget of Gaussians: rungs that show more are neither fetched nor shown."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.play.offers import OVER_BUDGET
from airgs_codec.play.policies.named import ORACLES
from tests.faces import (
    ADAPTIVE,
    NONE,
    ConfigError,
    Link,
    Lost,
    Manifest,
    Offers,
    SessionSettings,
    Shown,
    SimulatedDownloader,
    Trace,
    format_metrics,
    make_policy,
    run,
    session_bound,
    simulate,
)
from tests.support.manifests import in_groups, tiny_manifest

LINK = Link(Trace.open("const:9"), 0.0)
POLICIES = ("fixed:0", *ADAPTIVE, *ORACLES)


def tiered(counts=((10, 30), (20, 60))) -> Manifest:
    """Two groups with these rows in their two tiers; the last level needs the first tier alone, the others both."""
    m = tiny_manifest()
    groups = [
        replace(group, tiers=[replace(tier, count=n) for tier, n in zip(group.tiers, rows, strict=True)])
        for group, rows in zip(m.groups, counts, strict=True)
    ]
    return replace(m, groups=in_groups(groups), levels=[*m.levels[:2], replace(m.levels[2], tiers=1)])


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize(("budget", "most", "levels"), [(20, 20, {2}), (79, 40, {0, 1, 2}), (80, 80, {0, 1, 2})])
def test_no_policy_shows_or_fetches_more(policy, budget, most, levels):
    """79 Gaussians are enough for both tiers of the first group, but for one of the second."""
    c = Offers(tiered(), 0, 1000)
    log = simulate(c, LINK, policy, SessionSettings(budget=budget, loops=2))
    assert log.metrics.gaussians == most
    assert all(c.offer(s.segment).rungs[s.rung].gaussians <= budget for s in log.shown)
    assert {c.rungs[fetch.rung][1] for fetch in log.fetches if fetch.kind != "tables"} <= levels
    assert not log.lost and f"of a budget of {budget}" in format_metrics(log)


def test_without_a_budget_all_are_shown():
    log = simulate(Offers(tiered(), 0, 1000), LINK, "robust-mpc")
    assert log.metrics.gaussians == 80 and "at most 80\n" in format_metrics(log)


def test_looking_ahead_counts_what_the_budget_forbids():
    """No path leads through a rung over the budget, and the bound does not show one either."""
    c = Offers(tiered(), 0, 1000)
    first, second = (c.offer(segment, budget=79) for segment in (0, 1))
    allowed = np.array([rung.allowed for rung in second.rungs])
    assert all(rung.allowed for rung in first.rungs) and allowed.tolist() == [False, False, True] * 2
    assert np.all(second.bytes_after(first, NONE)[:, ~allowed] == OVER_BUDGET) and max(first.sizes(NONE)) < OVER_BUDGET
    assert [p.index for p in second.options(NONE)] == [2, 5]
    log = simulate(c, LINK, "fixed:0", SessionSettings(budget=79, loops=1))
    free = session_bound(simulate(Offers(tiered(), 0, 1000), LINK, "fixed:0", SessionSettings(loops=1)))
    bound = session_bound(log)
    assert bound == pytest.approx((40 + 34) / 2) and free == pytest.approx(40)
    assert log.mean_quality <= bound + 1e-6


def test_a_budget_that_no_rung_meets():
    with pytest.raises(ConfigError, match="budget: expected 20 Gaussians or more, got 19"):
        simulate(Offers(tiered()), LINK, "robust-mpc", SessionSettings(budget=19))
    with pytest.raises(ConfigError, match="budget: expected at least 1 Gaussian, got 0"):
        SessionSettings(budget=0)


def test_a_player_that_does_not_know_all_tables_ahead():
    """The first group decides whether it plays at all; a later one without a rung is lost."""
    c = Offers(tiered(), 0, 1000)
    policy = make_policy("fixed:0", c)

    def events(budget):
        return list(run(c, SimulatedDownloader(LINK, c, {}), policy, SessionSettings(budget=budget, loops=1)))

    seen = events(15)
    assert [e.rung is None for e in seen if isinstance(e, Shown)] == [False, True]
    assert [e.position for e in seen if isinstance(e, Lost)] == [1]
    with pytest.raises(ConfigError, match="expected 10 Gaussians or more"):
        events(9)

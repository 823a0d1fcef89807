"""The policies choose as the vectors say."""

import pytest

from airgs_codec.play.policies.mpc import discounted_throughput
from airgs_codec.play.policies.state import estimate_throughput
from tests.support.offers import NumberOffers
from tests.support.policy_states import choices, player_state
from tests.support.vectors import cases

OFFERS = [NumberOffers(numbers) for numbers in cases("policies", "offers")]
STATES = cases("policies", "states")


def test_estimates():
    for state in STATES:
        history = player_state(OFFERS[state["offer"]], state).history
        found = {"throughput": estimate_throughput(history), "discounted": discounted_throughput(history)}
        assert found == pytest.approx(state["estimates"], rel=1e-8)


def test_choices():
    for state in STATES:
        assert choices(OFFERS[state["offer"]], state) == state["choices"], state


def test_there_is_something_to_choose():
    """Of the offers with several rungs every policy takes most, and no two policies always the same."""
    several = [state["choices"] for state in STATES if len(OFFERS[state["offer"]].segments[0].rungs) > 1]
    taken = {name: [choice[name][0] for choice in several] for name in several[0]}
    assert len(STATES) > 60 and min(len(set(rungs)) for rungs in taken.values()) >= 3
    assert len({tuple(rungs) for rungs in taken.values()}) == len(taken)

"""States of players as the vectors have them, and what policies answer."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from airgs_codec.play.policies.named import ADAPTIVE
from airgs_codec.play.policies.state import Download, PlayerState
from tests.support.manifests import keys
from tests.support.offers import NumberOffers

State = Mapping[str, Any]


def player_state(offers: NumberOffers, state: State) -> PlayerState:
    position, offer = state["position"], offers.at(state["position"])
    decoded = keys(*state["decoded"], group=offer.group)
    return PlayerState(
        position=position,
        offer=offer,
        upcoming=partial(offers.upcoming, position, state["end"], decoded),
        decoded=decoded,
        options=tuple(option for option in offer.options(decoded) if option.index not in state["unavailable"]),
        now_s=state["now_s"],
        deadline_s=state["deadline_s"],
        buffer_limit_s=state["buffer_limit_s"],
        request_latency_s=state["request_latency_s"],
        pipelined=True,
        shown_quality=state["shown_quality"],
        history=tuple(Download(size, seconds) for size, seconds in state["history"]),
    )


def choices(offers: NumberOffers, state: State) -> dict[str, list[Any]]:
    """Policy -> its rung, whether that fits, and its wire bytes."""
    asked = player_state(offers, state)
    answers = {name: policy.choose(asked) for name, policy in ADAPTIVE.items()}
    return {name: [d.index, d.fits, d.size_bytes] for name, d in answers.items()}

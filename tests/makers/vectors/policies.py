"""What policies choose in the states of policies.json: regression vectors, made by the policies.

Packages and states are those of the committed file; of a new state that is added there, the answers are made. One whose
choice hangs on the last digits of a number is no vector: another order of sums is right, too.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from airgs_codec.play.policies.mpc import discounted_throughput
from airgs_codec.play.policies.state import Coming, estimate_throughput
from tests.faces import ADAPTIVE, NONE, Download, Offers, PlayerState
from tests.makers.vectors.text import Table, plain
from tests.support.manifests import keys
from tests.support.session_packages import offers_of
from tests.support.vectors import Case, cases


def table() -> Table:
    """Packages; states of players of one, with the estimates and the choice of every policy."""
    packages = cases("policies", "packages")
    offers = [offers_of(numbers) for numbers in packages]
    states = [state | _answers(player_state(offers[state["package"]], state)) for state in cases("policies", "states")]
    return {"packages": packages, "states": states}


def _answers(state: PlayerState) -> dict[str, Any]:
    """Policy -> its rung, whether that fits, and its wire bytes; and what two of them think of the link."""
    made = {name: policy.choose(state) for name, policy in ADAPTIVE.items()}
    estimates = {"throughput": estimate_throughput, "discounted": discounted_throughput}
    return {
        "estimates": {name: plain(estimate(state.history)) for name, estimate in estimates.items()},
        "choices": {name: [d.index, d.fits, d.size_bytes] for name, d in made.items()},
    }


def player_state(offers: Offers, state: Case) -> PlayerState:
    positions = range(state["position"], state["end"])
    loop, segment = offers.place(state["position"])
    offer = offers.offer(segment)
    decoded = keys(*state["decoded"], group=offer.group)

    def upcoming() -> Iterator[Coming]:
        yield from ((offer, decoded if at == loop else NONE) for at, offer in offers.upcoming(positions))

    return PlayerState(
        position=state["position"],
        offer=offer,
        upcoming=upcoming,
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

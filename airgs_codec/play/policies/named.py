"""The table of policies by name, for command lines and studies."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from airgs_codec._arguments import argument
from airgs_codec.errors import ConfigError
from airgs_codec.play.ladder import Decision
from airgs_codec.play.offers import Offers
from airgs_codec.play.policies.mpc import HORIZON_SEGMENTS, choose_robust_mpc
from airgs_codec.play.policies.paper import (
    choose_paper,
    choose_paper_literal,
    choose_paper_literal_no_cliff,
    choose_paper_no_cliff,
)
from airgs_codec.play.policies.simple import (
    choose_bola,
    choose_fixed,
    choose_oracle_frame,
    choose_oracle_lp,
    choose_throughput,
)
from airgs_codec.play.policies.state import PlayerState, Policy
from airgs_codec.play.trace import Link

Choose = Callable[[PlayerState], Decision]

DEFAULT_POLICY = "robust-mpc"
ADAPTIVE = {
    policy.name: policy
    for policy in (
        Policy("paper", choose_paper),
        Policy("paper-no-cliff", choose_paper_no_cliff),
        Policy("paper-literal", choose_paper_literal),
        Policy("paper-literal-no-cliff", choose_paper_literal_no_cliff),
        Policy("throughput", choose_throughput),
        Policy("bola", choose_bola),
        Policy("robust-mpc", choose_robust_mpc, horizon=HORIZON_SEGMENTS),
    )
}
ORACLES: dict[str, Callable[[PlayerState, Link], Decision]] = {
    "oracle-frame": choose_oracle_frame,
    "oracle-lp": choose_oracle_lp,
}
NAMES = (*ADAPTIVE, *ORACLES)


def make_policy(policy: Policy | Choose | str, offers: Offers, link: Link | None = None) -> Policy:
    """A policy by name, or fixed:J (level J with the finest keys) or fixed:RUNG (such as Q1+L3), or of a function.

    A value is returned as it is. The oracles need the link. Raises ConfigError for other names, and for an oracle
    without a link.
    """
    if callable(policy):
        policy = Policy(getattr(policy, "__name__", type(policy).__name__), policy)
    if isinstance(policy, Policy):
        return policy
    name = argument("policy", policy, str, "a name, a function from PlayerState to Decision or a Policy")
    if name in ADAPTIVE:
        return ADAPTIVE[name]
    if name in ORACLES:
        if link is None:
            raise ConfigError(f"policy {name}: expected a trace, which it knows in advance, got a real connection")
        oracle, known = ORACLES[name], link
        return Policy(name, lambda state: oracle(state, known), may_replace=False)
    rung = _fixed_rung(name, offers)
    choose = partial(choose_fixed, rung=rung)
    return Policy(name, choose, may_abandon=False, may_replace=False, needs_quality=False)


def _fixed_rung(name: str, offers: Offers) -> int:
    kind, _, rung = name.partition(":")
    levels = len(offers.manifest.levels)
    if kind == "fixed" and rung in offers.names:
        return offers.names.index(rung)
    if kind == "fixed" and rung.isdigit() and int(rung) < levels:
        return int(rung)
    names = f"{', '.join(NAMES)}, fixed:0 … fixed:{levels - 1} or fixed:{offers.names[-1]}"
    raise ConfigError(f"policy: expected {names}, got {name!r}")

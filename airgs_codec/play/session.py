"""Whole sessions: `simulate` plays over a trace, `play` from anywhere; and what nobody could have done better."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from airgs_codec._arguments import argument
from airgs_codec.errors import FormatError
from airgs_codec.package.package import OPENED, Package, open_package
from airgs_codec.play.bound import Slot, solve_horizon
from airgs_codec.play.downloader import Downloader, SimulatedDownloader
from airgs_codec.play.metrics import SessionLog
from airgs_codec.play.offers import Offers
from airgs_codec.play.player import SHORTEST_S, run
from airgs_codec.play.playout import SessionSettings
from airgs_codec.play.policies import DEFAULT_POLICY, Choose, Policy, make_policy
from airgs_codec.play.trace import Link, Trace


def play(
    offers: Offers,
    downloader: Downloader,
    policy: Policy | Choose | str = DEFAULT_POLICY,
    settings: SessionSettings | None = None,
    link: Link | None = None,
) -> SessionLog:
    """Play a package from wherever the downloader fetches it; `link` is what a simulated one is of.

    `policy` is what `make_policy` takes. Raises ConfigError for an unknown policy, one that needs what is not known and
    one that decides for another rung than those offered, TransportError when the link fails.
    """
    rule, rules = make_policy(policy, offers, link), settings or SessionSettings()
    return SessionLog.of(run(offers, downloader, rule, rules), offers, rule.name, rules, link)


def simulate(
    package: Package | Offers | str | Path,
    trace: Trace | Link | str | Path,
    policy: Policy | Choose | str = DEFAULT_POLICY,
    settings: SessionSettings | None = None,
    faults: Mapping[str, FormatError] | None = None,
) -> SessionLog:
    """Play a package over a trace, with the trace's own round trip, or over a link.

    A package may be given by its path, a trace as `Trace.open` takes it. `policy`: one of the names that `make_policy`
    takes, a function from PlayerState to Decision, or a Policy; `faults`: files that cannot be used, as `find_faults`
    gives them. Raises ConfigError for an unknown policy, one that needs quality that was not measured and one that
    decides for a rung that is not offered, and for a budget that all rungs of a segment are over; TransportError for a
    trace that ends too soon; and what `open_package` raises.
    """
    if not isinstance(package, Offers):
        package = Offers.of(argument("package", package, Package, OPENED, open_package))
    if not isinstance(trace, Link):
        trace = Link.over(argument("trace", trace, Trace, "a trace, or its path or name", Trace.open))
    rules = argument("settings", settings or SessionSettings(), SessionSettings, "SessionSettings")
    package.check_budget(range(package.segments), rules.budget)
    return play(package, SimulatedDownloader(trace, package, faults or {}), policy, rules, trace)


def session_bound(log: SessionLog) -> float | None:
    """Return the upper bound on the mean PSNR (dB) of any player that shows each segment when this one did.

    None when segments were lost, without measured quality, and over a real connection, whose capacity is not known.
    """
    link = log.link
    if link is None or not log.offers.manifest.measured or any(shown.rung is None for shown in log.shown):
        return None
    slots, offers, limit, manifest_s = [], log.offers, log.settings.buffer_s, log.fetches[0].arrival_s
    fronts = np.cumsum([0.0, *(s.frames / offers.fps for s in log.shown)])  # media time at which each begins
    for k, shown in enumerate(log.shown):
        release = manifest_s
        wanted = float(fronts[k + 1]) - limit  # media that must have been shown before the request
        if wanted > SHORTEST_S:  # not where rounding alone makes the buffer too small
            i = int(np.searchsorted(fronts, wanted - SHORTEST_S)) - 1  # before a stall, if one follows just there
            release = max(release, log.shown[i].start_s + wanted - float(fronts[i]))
        begin, deadline = release + link.rtt_s, shown.start_s - log.settings.decode_frame_s
        capacities = link.bytes_between(0.0, begin), link.bytes_between(0.0, deadline)
        slots.append(Slot(offers.offer(shown.segment, budget=log.settings.budget), *capacities))
    solution = solve_horizon(slots)
    return None if solution is None else solution.quality

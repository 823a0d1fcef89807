"""What policies choose, and whole sessions over simulated links: regression vectors, made by policies and the player.

Packages, links, states and what players are told are those of the committed files; of a new state or session that is
added there, the answers are made. A state whose choice hangs on the last digits of a number is no vector: another order
of sums is right, too.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from airgs_codec.play.policies import discounted_throughput
from tests import faces
from tests.faces import NONE, Arrived, Coming, Cut, Event, FormatError, GiveUp, PlayerState, SimulatedDownloader
from tests.support.manifests import keyframes
from tests.support.paths import GOLDEN
from tests.support.session_packages import Numbers, growing_offers, offers_of
from tests.support.vectors import Case, Table, cases, plain


def policies() -> Table:
    """Packages; states of players of one, with the estimates and the choice of every policy."""
    packages = cases("policies", "packages")
    offers = [offers_of(numbers) for numbers in packages]
    states = [state | _answers(player_state(offers[state["package"]], state)) for state in cases("policies", "states")]
    return {"packages": packages, "states": states}


def _answers(state: PlayerState) -> dict[str, Any]:
    """Policy -> its rung, whether that fits, and its wire bytes; and what two of them think of the link."""
    made = {name: policy.choose(state) for name, policy in faces.ADAPTIVE.items()}
    estimates = {"throughput": faces.estimate_throughput, "discounted": discounted_throughput}
    return {
        "estimates": {name: plain(estimate(state.history)) for name, estimate in estimates.items()},
        "choices": {name: [d.index, d.fits, d.size_bytes] for name, d in made.items()},
    }


def player_state(offers: faces.Offers, state: Case) -> PlayerState:
    positions = range(state["position"], state["end"])
    loop, segment = offers.place(state["position"])
    offer = offers.offer(segment)
    decoded = keyframes(*state["decoded"], group=offer.group)

    def upcoming() -> Iterator[Coming]:
        for at, number in map(offers.place, positions):
            yield offers.offer(number), decoded if at == loop else NONE

    told = ("position", "now_s", "deadline_s", "buffer_limit_s", "request_latency_s", "shown_quality")
    return PlayerState(
        **{name: state[name] for name in told},
        offer=offer,
        upcoming=upcoming,
        decoded=decoded,
        options=tuple(option for option in offer.options(decoded) if option.index not in state["unavailable"]),
        pipelined=True,
        history=tuple(faces.Download(size, seconds) for size, seconds in state["history"]),
    )


class GrowingDownloader:
    """A simulated downloader over a package to which groups are added whenever airgs.json is read again."""

    def __init__(self, below: SimulatedDownloader, steps: Iterator[tuple[faces.Manifest, int]]) -> None:
        self._below, self._steps, self._opened = below, steps, False
        self.rtt_s, self.pipelines = below.rtt_s, below.pipelines

    def fetch(self, request: faces.Request, give_up: GiveUp | None = None) -> faces.Arrival:
        grows = self._opened and request.batch.tables == (faces.JSON_NAME,)
        if grows and (step := next(self._steps, None)) is not None:
            self._below.offers.grow(*step)
        self._opened = True
        return self._below.fetch(request, give_up)


def sessions() -> Table:
    """Packages, links, and sessions: what was fetched when, what was given up and replaced, and what was shown."""
    packages, traces, played = (cases("sessions", part) for part in ("packages", "traces", "sessions"))
    packages = [_of_golden(numbers) for numbers in packages]
    played = [one | {"events": events(one, packages[one["package"]], traces[one["trace"]])} for one in played]
    return {"packages": packages, "traces": traces, "sessions": played}


def events(play: Case, numbers: Numbers, trace: Case) -> list[list[Any]]:
    offers = offers_of(numbers)
    faults = {path: FormatError(reason, path, "made up") for path, reason in play["faults"].items()}
    if play["growth"]:
        offers, steps = growing_offers(numbers, play["growth"])
    starts, rates = (np.array(trace[name], float) for name in ("starts_s", "rates_bps"))
    link = faces.Link(faces.Trace(trace["name"], starts, rates, trace["duration_s"]), play["rtt_s"])
    below = SimulatedDownloader(link, offers, faults, pipelines=False)  # as browsers
    downloader = GrowingDownloader(below, steps) if play["growth"] else below
    policy, settings = faces.make_policy(play["policy"], offers), faces.SessionSettings(**play["settings"])
    return [row(event) for event in faces.run(offers, downloader, policy, settings)]


def row(event: Event) -> list[Any]:
    match event:
        case Arrived(a):
            r = a.request
            times = plain([r.sent_s, a.first_byte_s, a.at_s])
            files = [int(a.abandoned), len(a.whole), len(a.refused)]
            return [r.kind.value, r.position, r.rung, a.bytes, *times, *files]
        case faces.Replaced():
            return ["replaced", event.position, event.before, event.after]
        case faces.Lost():
            return ["lost", event.position, plain(event.at_s)]
        case Cut():
            return ["cut", plain(event.at_s)]
    times = plain([event.ready_s, event.start_s, event.stall_s])
    return ["shown", event.segment, event.loop, -1 if event.rung is None else event.rung, event.frames, *times]


def _of_golden(numbers: Numbers) -> Case:
    """The numbers of the golden package of that name; others are only numbers."""
    if not (GOLDEN / numbers["name"]).is_dir():
        return dict(numbers)
    package = faces.open_package(GOLDEN / numbers["name"])
    groups = []
    for number, g in enumerate(package.manifest.groups, 1):
        parts = [(s.stop - s.start, [v.file.bytes for v in s.levels], [v.psnr for v in s.levels]) for s in g.segments]
        segments = [dict(zip(("frames", "bytes", "psnr"), part, strict=True)) for part in parts]
        table = package.manifest.entry(faces.group_path(number)).bytes
        sidecars = [tier.sidecar.bytes for tier in g.tiers]
        pictures = [[picture.bytes for picture in tier.pictures] for tier in g.tiers]
        groups.append({"table": table, "sidecars": sidecars, "pictures": pictures, "segments": segments})
    return {**numbers, "root_bytes": package.root_bytes, "groups": groups}

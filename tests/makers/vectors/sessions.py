"""Whole sessions over simulated links: regression vectors, made by the player.

Packages, links and what players are told are those of the committed file; of a new session that is added there, the
events are made: what was fetched when, what was given up and replaced, and what was shown.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from airgs_codec.play.downloader import Cut, Event, GiveUp
from tests.faces import (
    JSON_NAME,
    Arrival,
    Arrived,
    FormatError,
    Link,
    Lost,
    Manifest,
    Replaced,
    Request,
    SessionSettings,
    SimulatedDownloader,
    Trace,
    group_path,
    make_policy,
    open_package,
    run,
)
from tests.makers.vectors.text import Table, plain
from tests.support.paths import GOLDEN
from tests.support.session_packages import Numbers, growing_offers, offers_of
from tests.support.vectors import Case, cases


class GrowingDownloader:
    """A simulated downloader over a package to which groups are added whenever airgs.json is read again."""

    def __init__(self, below: SimulatedDownloader, steps: Iterator[tuple[Manifest, int]]) -> None:
        self._below, self._steps, self._opened = below, steps, False
        self.rtt_s, self.pipelines = below.rtt_s, below.pipelines

    def fetch(self, request: Request, give_up: GiveUp | None = None) -> Arrival:
        grows = self._opened and request.batch.tables == (JSON_NAME,)
        if grows and (step := next(self._steps, None)) is not None:
            self._below.offers.grow(*step)
        self._opened = True
        return self._below.fetch(request, give_up)


def events(play: Case, numbers: Numbers, trace: Case) -> list[list[Any]]:
    offers = offers_of(numbers)
    faults = {path: FormatError(reason, path, "made up") for path, reason in play["faults"].items()}
    if play["growth"]:
        offers, steps = growing_offers(numbers, play["growth"])
    starts, rates = (np.array(trace[name], float) for name in ("starts_s", "rates_bps"))
    link = Link(Trace(trace["name"], starts, rates, trace["duration_s"]), play["rtt_s"])
    below = SimulatedDownloader(link, offers, faults, play["pipelines"])
    downloader = GrowingDownloader(below, steps) if play["growth"] else below
    policy = make_policy(play["policy"], offers)
    return [row(event) for event in run(offers, downloader, policy, SessionSettings(**play["settings"]))]


def row(event: Event) -> list[Any]:
    match event:
        case Arrived(a):
            r = a.request
            times = plain([r.sent_s, a.first_byte_s, a.at_s])
            files = [int(a.abandoned), len(a.whole), len(a.refused)]
            return [r.kind.value, r.position, r.rung, a.bytes, *times, *files]
        case Replaced():
            return ["replaced", event.position, event.before, event.after]
        case Lost():
            return ["lost", event.position, plain(event.at_s)]
        case Cut():
            return ["cut", plain(event.at_s)]
    times = plain([event.ready_s, event.start_s, event.stall_s])
    return ["shown", event.segment, event.loop, -1 if event.rung is None else event.rung, event.frames, *times]


def _of_golden(numbers: Numbers) -> Case:
    """The numbers of the golden package of that name; others are only numbers."""
    if not (GOLDEN / numbers["name"]).is_dir():
        return dict(numbers)
    package = open_package(GOLDEN / numbers["name"])
    groups = [
        {
            "table": package.manifest.entry(group_path(number)).bytes,
            "sidecars": [tier.sidecar.bytes for tier in group.tiers],
            "pictures": [[picture.bytes for picture in tier.pictures] for tier in group.tiers],
            "segments": [
                {
                    "frames": segment.stop - segment.start,
                    "bytes": [level.file.bytes for level in segment.levels],
                    "psnr": [level.psnr for level in segment.levels],
                }
                for segment in group.segments
            ],
        }
        for number, group in enumerate(package.manifest.groups, 1)
    ]
    return {**numbers, "root_bytes": package.root_bytes, "groups": groups}


def table() -> Table:
    packages, traces, sessions = (cases("sessions", part) for part in ("packages", "traces", "sessions"))
    packages = [_of_golden(numbers) for numbers in packages]
    played = [one | {"events": events(one, packages[one["package"]], traces[one["trace"]])} for one in sessions]
    return {"packages": packages, "traces": traces, "sessions": played}

"""A session as a whole: the log as a fold over a player's events, and `simulate`, which plays over a trace."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec._arguments import argument, brief
from airgs_codec.decoder.decode import decode_canonical, decode_segment
from airgs_codec.errors import ConfigError, FormatError
from airgs_codec.package.layout import FileKind, file_kind
from airgs_codec.package.package import OPENED, Package, open_package
from airgs_codec.play.bound import Horizon, Slot, solve_horizon
from airgs_codec.play.downloader import (
    Arrival,
    Arrived,
    BatchKind,
    Cut,
    Downloader,
    Event,
    Lost,
    Replaced,
    Shown,
    SimulatedDownloader,
)
from airgs_codec.play.fetcher import SHORTEST_S
from airgs_codec.play.metrics import (
    Fetch,
    SessionMetrics,
    frame_times,
    mean_quality,
    session_metrics,
)
from airgs_codec.play.offers import Offers
from airgs_codec.play.player import run
from airgs_codec.play.playout import screen_ticks
from airgs_codec.play.policies.named import DEFAULT_POLICY, Choose, make_policy
from airgs_codec.play.policies.state import Policy
from airgs_codec.play.settings import SessionSettings
from airgs_codec.play.trace import Link, Trace


@dataclass(frozen=True, eq=False)
class SessionLog:
    """Everything that happened in a session; figures are derived from it."""

    offers: Offers
    settings: SessionSettings
    policy: str
    link: Link | None  # None over a real connection
    fetches: tuple[Fetch, ...]  # in the order of their arrival
    shown: tuple[Shown, ...]  # one for each position
    bytes_by_kind: Mapping[FileKind, int]  # of files that were of use, without headers
    lost: tuple[str, ...]  # what could not be had, one line each
    retried: tuple[str, ...]  # what was asked for again, one line each

    __repr__ = brief

    @staticmethod
    def of(
        events: Iterable[Event],
        offers: Offers,
        policy: str,
        settings: SessionSettings,
        link: Link | None = None,
    ) -> SessionLog:
        fold = _Fold(offers)
        for event in events:
            fold.add(event)
        return SessionLog(
            offers=offers,
            settings=settings,
            policy=policy,
            link=link,
            fetches=tuple(fold.fetch(number) for number in range(len(fold.arrived))),
            shown=tuple(fold.shown),
            bytes_by_kind=dict(fold.bytes_by_kind),
            lost=tuple(fold.lost),
            retried=tuple(fold.retried),
        )

    @cached_property
    def metrics(self) -> SessionMetrics:
        return session_metrics(self.offers, self.link, self.fetches, self.shown, self.bytes_by_kind)

    @property
    def events(self) -> list[dict[str, Any]]:
        """Batches ("fetch") and segments that were on the screen ("show") as plain values, in the order of `at_s`."""
        fetched = [{"event": "fetch", "at_s": fetch.arrival_s, **asdict(fetch)} for fetch in self.fetches]
        shown = [{"event": "show", "at_s": shown.start_s, **asdict(shown)} for shown in self.shown]
        return sorted([*fetched, *shown], key=lambda event: event["at_s"])

    def to_pandas(self) -> Any:
        """`events` as a pandas.DataFrame, a row each, with the figures of `metrics` in its `attrs`.

        Raises ConfigError where pandas is not installed.
        """
        if not find_spec("pandas"):
            raise ConfigError("a data frame needs pandas: pip install pandas")
        frame = import_module("pandas").DataFrame(self.events)
        frame.attrs.update(self.metrics.as_dict())
        return frame

    @property
    def screen_ticks(self) -> list[tuple[int, int]]:
        """(entry of `shown`, frame of it) for every display tick; see `playout.screen_ticks`."""
        return screen_ticks(self.shown, self.offers.fps)

    @property
    def frame_times(self) -> NDArray[np.float64]:
        """Seconds that every frame shown was on its way; see `metrics.frame_times`."""
        return frame_times(self.fetches, self.shown)

    @property
    def mean_quality(self) -> float:
        """PSNR in dB, mean over media time, as `session_bound` counts it."""
        return mean_quality(self.shown)


def play(
    offers: Offers,
    downloader: Downloader,
    policy: Policy | Choose | str = DEFAULT_POLICY,
    settings: SessionSettings | None = None,
    link: Link | None = None,
) -> SessionLog:
    """Play a package from wherever the downloader fetches it; `link` is what a simulated one is of.

    `policy` is what `make_policy` takes. Raises ConfigError for an unknown policy, one that needs what is not known and
    one that decides for what there is not, TransportError when the link fails.
    """
    rule, rules = make_policy(policy, offers, link), _rules(settings)
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
    decides for what there is not, and for a budget that all rungs of a segment are over; TransportError for a trace
    that ends too soon; and what `open_package` raises.
    """
    if not isinstance(package, Offers):
        package = Offers.of(argument("package", package, Package, OPENED, open_package))
    offers = package
    if not isinstance(trace, Link):
        trace = Link.over(argument("trace", trace, Trace, "a trace, or its path or name", Trace.open))
    link = trace
    rules = _rules(settings)
    offers.check_budget(range(offers.segments), rules.budget)
    return play(offers, SimulatedDownloader(link, offers, faults or {}), policy, rules, link)


def _rules(settings: SessionSettings | None) -> SessionSettings:
    return argument("settings", SessionSettings() if settings is None else settings, SessionSettings, "SessionSettings")


def session_bound(log: SessionLog, integer: bool = False) -> float | None:
    """Upper bound on the mean PSNR (dB) of any player that shows each segment when this one did; see `bound`.

    None when segments were lost, and over a real connection, whose capacity is not known.
    """
    link = log.link
    if link is None or any(shown.rung is None for shown in log.shown):
        return None
    slots = []
    manifest_s = log.fetches[0].arrival_s
    offers, limit = log.offers, log.settings.buffer_s
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
    schedule = solve_horizon(Horizon(tuple(slots)), integer)
    return None if schedule is None else schedule.quality


@dataclass(slots=True, eq=False)
class _Fold:
    """What the events so far amount to."""

    offers: Offers
    arrived: list[Arrived] = field(default_factory=list)
    shown: list[Shown] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    retried: list[str] = field(default_factory=list)
    bytes_by_kind: Counter[FileKind] = field(default_factory=Counter)
    on_timeline: set[int] = field(default_factory=set)  # batches, by their place in `arrived`
    replaced_bytes: Counter[int] = field(default_factory=Counter)  # state that a batch brought in vain
    state_source: dict[int, int] = field(default_factory=dict)  # position -> the batch that brought its state

    def add(self, event: Event) -> None:
        if isinstance(event, Arrived):
            self._arrived(event)
        elif isinstance(event, Replaced):
            self._replaced(event)
        elif isinstance(event, Lost):
            start, stop = self.offers.span(self.offers.place(event.position)[1])
            frames = f"frames {start}-{stop - 1}"
            self.lost.append(f"{frames} at {event.at_s:.2f} s: no rung can be had, the last picture stands")
        elif isinstance(event, Cut):
            self.lost.append(f"at {event.at_s:.2f} s: {event.why}")
        else:
            self.shown.append(event)

    def _arrived(self, event: Arrived) -> None:
        arrival, number = event.arrival, len(self.arrived)
        self.arrived.append(event)
        for path in arrival.usable:
            self.bytes_by_kind[file_kind(path)] += self.offers.file_bytes(path)
        self.lost += [f"{path} at {arrival.at_s:.2f} s: {why.detail}" for path, why in arrival.refused.items()]
        self.retried += [f"{retry.path} before {arrival.at_s:.2f} s: {retry.why}" for retry in arrival.retries]
        if arrival.complete and arrival.request.kind in (BatchKind.GROUP, BatchKind.STATE):
            self.on_timeline.add(number)
            self.state_source[arrival.request.position] = number

    def _replaced(self, event: Replaced) -> None:
        """A state that another takes the place of was fetched in vain; keys are not, they stay decoded."""
        number, offer = len(self.arrived) - 1, self.offers.offer(self.offers.place(event.position)[1])
        self.on_timeline.add(number)
        before, after = offer.rungs[event.before], offer.rungs[event.after]
        if before.level != after.level:
            source = self.state_source.get(event.position)
            if source is not None:  # None: the level had nothing to fetch
                self.replaced_bytes[source] += before.state_bytes
            self.state_source[event.position] = number

    def fetch(self, number: int) -> Fetch:
        """A batch, once all events are known."""
        event = self.arrived[number]
        arrival, request = event.arrival, event.arrival.request
        return Fetch(
            kind=request.kind,
            position=request.position,
            rung=request.rung,
            files=len(arrival.whole) + len(arrival.refused),
            retries=len(arrival.retries),
            bytes=arrival.bytes,
            wasted=self._useless_bytes(number, arrival) + self.replaced_bytes[number],
            request_s=request.sent_s,
            arrival_s=arrival.at_s,
            budget_bytes=event.budget_bytes,
            throughput_bps=event.throughput_bps,
            fits=event.decision.fits,
            abandoned=arrival.abandoned,
            shown=number in self.on_timeline,
            reason=event.decision.reason,
        )

    def _useless_bytes(self, number: int, arrival: Arrival) -> int:
        """Bytes of a batch that served nothing: all of a replacement that was not put in place, and what was not usable
        of another.
        """
        if arrival.request.kind is BatchKind.REPLACEMENT:
            return 0 if number in self.on_timeline else arrival.bytes
        if arrival.complete:
            return sum(retry.bytes for retry in arrival.retries)
        used = self.offers.wire_bytes([self.offers.file_bytes(path) for path in arrival.usable])
        return max(0, arrival.bytes - used)


def measure_decoding(package: Package) -> float:
    """Seconds a frame that this machine takes to decode the package once at its top rung, keys included."""
    m = package.manifest
    began = time.perf_counter()
    group = -1
    for index, segment in enumerate(m.segments):
        if m.group_of(index) != group:
            group = m.group_of(index)
            base = decode_canonical(package, group, 0)
        for _ in decode_segment(package, index, base, 0, range(segment.stop - segment.start)):
            pass
    return (time.perf_counter() - began) / m.frames

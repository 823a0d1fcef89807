"""What a session was like: its log as a fold over a player's events, and figures over its batches and segments.

PSNR has three definitions in this package. Packages: the PSNR of the squared error pooled over views and frames.
Training: the mean over views of each view's dB. Sessions, here: every segment has the package's PSNR of its rung, and
a session the mean of these dB over display ticks, moments every 1 / fps seconds from the first picture on.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cached_property
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np

from airgs_codec._arguments import brief
from airgs_codec.errors import ConfigError, TransportError
from airgs_codec.package.layout import FileKind, file_kind
from airgs_codec.play.downloader import Arrived, BatchKind, Cut, Displayed, Event, Lost, Replaced
from airgs_codec.play.offers import Offers
from airgs_codec.play.player import SHORTEST_S
from airgs_codec.play.playout import SessionSettings
from airgs_codec.play.trace import Link

# QoE loses this for as much waiting as play: Puffer counts 100 dB a second, in chunks of two (Yan et al., NSDI 2020),
# Yin et al. (SIGCOMM 2015) what the best rung shows, in chunks of four: some 170 here.
WAITING_DB = 200.0
QOE_WORDS = f"quality - changes - {WAITING_DB / 100:g} dB for each per cent of waiting"
NEXT = (BatchKind.GROUP, BatchKind.DELTA)  # batches of the segment that comes next


@dataclass(slots=True)
class Fetch:
    kind: BatchKind
    position: int  # of the segment in the session
    rung: int
    files: int  # that came, or were refused
    retries: int  # requests of theirs that got faulty answers
    bytes: int  # with headers; of an abandoned batch, what had passed
    wasted: int  # of them: abandoned, broken, too late or replaced later
    request_s: float
    arrival_s: float
    budget_bytes: float
    throughput_bps: float  # the estimate at the request
    fits: bool
    abandoned: bool
    shown: bool  # the segment was put on the timeline with what this batch brought
    reason: str  # of the choice, for people


@dataclass(frozen=True, slots=True)
class SessionMetrics:
    """Figures of one session. Frames of lost segments have no quality: they are counted, but not in PSNR."""

    frames: int
    played_s: float
    startup_s: float  # from the first request to the first picture
    startup_requests: int  # up to those of the files of the first picture
    startup_bytes: int  # of the answers to them, with headers
    startup_table_bytes: int  # of them, those of tables
    seek_s: float | None  # see `SessionLog.seek_s`
    stalls: int
    stall_s: float  # waited after the first picture
    stall_ratio: float  # of the time from the first picture to the last
    switches: int  # changes of the rung from one segment to the next
    psnr_mean: float | None  # dB, mean over display ticks, frozen ones with the picture that stood
    psnr_p5: float | None  # dB, 5th percentile of the same
    delta_e_mean: float | None  # CIEDE2000, mean over display ticks as for psnr_mean
    change_db: float  # mean change of PSNR from one segment to the next
    qoe: float | None  # dB: mean quality of segments - mean change - WAITING_DB * stall_s / played_s
    bytes: Mapping[str, int]  # by FileKind, of files that were of use, without headers
    bytes_per_frame: float
    bits_per_gaussian: float  # the same in bits, for each Gaussian that a frame shows; 0 where none is shown
    wire_bytes: int  # everything that passed, with headers
    wasted: float  # share of wire_bytes
    utilisation: float | None  # wire_bytes as a share of what could have passed; None over a real connection
    replaced: int  # replacements that were fetched
    abandoned: int
    retries: int  # requests that got faulty answers, and were made again
    lost_frames: int
    rungs: Mapping[str, int]  # segments shown with each; "lost" counts the others
    gaussians: int  # most that a picture showed

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


@dataclass(frozen=True, eq=False)
class SessionLog:
    offers: Offers
    settings: SessionSettings
    policy: str
    link: Link | None  # None over a real connection
    fetches: tuple[Fetch, ...]  # in the order of their arrival
    shown: tuple[Displayed, ...]  # one for each position
    bytes_by_kind: Mapping[FileKind, int]  # of files that were of use, without headers
    lost: tuple[str, ...]  # what could not be had, one line each
    retried: tuple[str, ...]  # what was asked for again, one line each

    __repr__ = brief

    @staticmethod
    def of(
        events: Iterable[Event], offers: Offers, policy: str, settings: SessionSettings, link: Link | None = None
    ) -> SessionLog:
        """Fold events into a log. Deltas of a replaced rung are wasted; its keyframes are not: they stay decoded."""
        fetches, shown, lost, retried = list[Fetch](), list[Displayed](), list[str](), list[str]()
        by_kind, brought = Counter[FileKind](), dict[int, Fetch]()  # position -> the batch that brought its delta
        for event in events:
            match event:
                case Arrived(arrival):
                    for path in arrival.usable:
                        by_kind[file_kind(path)] += offers.file_bytes(path)
                    lost += [f"{path} at {arrival.at_s:.2f} s: {why.detail}" for path, why in arrival.refused.items()]
                    retried += [f"{retry.path} before {arrival.at_s:.2f} s: {retry.why}" for retry in arrival.retries]
                    fetches.append(_fetch(offers, event))
                    if fetches[-1].shown:
                        brought[fetches[-1].position] = fetches[-1]
                case Replaced(position):
                    fetches[-1].shown, fetches[-1].wasted = True, 0
                    rungs = offers.offer(offers.place(position)[1]).rungs
                    before, after = rungs[event.before], rungs[event.after]
                    if before.level != after.level:
                        if position in brought:  # else the level had nothing to fetch
                            brought[position].wasted += before.delta_bytes
                        brought[position] = fetches[-1]
                case Lost(position, at_s):
                    start, stop = offers.span(offers.place(position)[1])
                    what = "no rung can be had, the last picture stands"
                    lost.append(f"frames {start}-{stop - 1} at {at_s:.2f} s: {what}")
                case Cut(at_s, why):
                    lost.append(f"at {at_s:.2f} s: {why}")
                case Displayed():
                    shown.append(event)
        folded = tuple(fetches), tuple(shown), dict(by_kind), tuple(lost), tuple(retried)
        return SessionLog(offers, settings, policy, link, *folded)

    @cached_property
    def metrics(self) -> SessionMetrics:
        offers, link, fetches, shown = self.offers, self.link, self.fetches, self.shown
        frames = sum(s.frames for s in shown)
        stalls = [s.stall_s for s in shown if s.stall_s > SHORTEST_S]
        played, stall = frames / offers.fps, math.fsum(stalls)
        on_screen = [shown[i] for i, _ in self.screen_ticks]
        psnr = np.array([s.psnr for s in on_screen if s.psnr is not None])
        found = [offers.offer(s.segment).rungs[s.rung] for s in shown if s.rung is not None]
        seen = [offers.offer(s.segment).rungs[s.rung] for s in on_screen if s.psnr is not None and s.rung is not None]
        drawn = sum(s.frames * offers.offer(s.segment).rungs[s.rung].gaussians for s in shown if s.rung is not None)
        quality = [s.psnr for s in shown if s.psnr is not None]
        changes = [abs(b - a) for a, b in itertools.pairwise(quality)]
        rungs = [s.rung for s in shown]
        counts = Counter("lost" if rung is None else offers.names[rung] for rung in rungs)
        wire, end_s = sum(f.bytes for f in fetches), max(f.arrival_s for f in fetches)
        brought = [(f.position, i) for i, f in enumerate(fetches) if f.shown and f.kind in NEXT]
        last = max((i for position, i in brought if position == brought[0][0]), default=len(fetches))
        first = fetches[: last + 1]  # up to the last batch that the first picture needs
        return SessionMetrics(
            frames=frames,
            played_s=played,
            startup_s=shown[0].start_s,
            startup_requests=sum(f.files + f.retries for f in first),
            startup_bytes=sum(f.bytes for f in first),
            startup_table_bytes=sum(f.bytes for f in first if f.kind is BatchKind.TABLES),
            seek_s=self.seek_s,
            stalls=len(stalls),
            stall_s=stall,
            stall_ratio=stall / (played + stall),
            switches=sum(a != b for a, b in itertools.pairwise(rungs)),
            psnr_mean=float(psnr.mean()) if len(psnr) else None,
            psnr_p5=float(np.percentile(psnr, 5)) if len(psnr) else None,
            delta_e_mean=float(np.mean([rung.delta_e for rung in seen])) if seen else None,
            change_db=float(np.mean(changes)) if changes else 0.0,
            qoe=(sum(quality) - sum(changes)) / len(quality) - WAITING_DB * stall / played if quality else None,
            bytes={kind.value: size for kind, size in self.bytes_by_kind.items()},
            bytes_per_frame=sum(self.bytes_by_kind.values()) / frames,
            bits_per_gaussian=8 * sum(self.bytes_by_kind.values()) / drawn if drawn else 0.0,
            wire_bytes=wire,
            wasted=sum(f.wasted for f in fetches) / wire,
            utilisation=wire / max(1.0, link.bytes_between(0.0, end_s)) if link else None,
            replaced=sum(f.kind is BatchKind.REPLACEMENT for f in fetches),
            abandoned=sum(f.abandoned for f in fetches),
            retries=sum(f.retries for f in fetches),
            lost_frames=sum(s.frames for s in shown if s.rung is None),
            rungs=dict(counts.most_common()),
            gaussians=max((rung.gaussians for rung in found), default=0),
        )

    @property
    def events(self) -> list[dict[str, Any]]:
        """Return batches ("fetch") and shown segments ("show") as plain values, in the order of `at_s`."""
        fetched = [{"event": "fetch", "at_s": fetch.arrival_s, **asdict(fetch)} for fetch in self.fetches]
        shown = [{"event": "show", "at_s": shown.start_s, **asdict(shown)} for shown in self.shown]
        return sorted([*fetched, *shown], key=lambda event: event["at_s"])

    def to_pandas(self) -> Any:
        """Return `events` as a pandas.DataFrame, a row each, with the figures of `metrics` in its `attrs`.

        Raises ConfigError where pandas is not installed.
        """
        if not find_spec("pandas"):
            raise ConfigError("a data frame needs pandas: pip install pandas")
        frame = import_module("pandas").DataFrame(self.events)
        frame.attrs.update(self.metrics.as_dict())
        return frame

    @property
    def screen_ticks(self) -> list[tuple[int, int]]:
        """Return (entry of `shown`, frame of it) for every display tick; the last frame stays during a stall."""
        ticks: list[tuple[int, int]] = []
        for i, entry in enumerate(self.shown):
            if i:
                ticks += [(i - 1, self.shown[i - 1].frames - 1)] * round(entry.stall_s * self.offers.fps)
            ticks += [(i, frame) for frame in range(entry.frames)]
        return ticks

    @property
    def seek_s(self) -> float | None:
        """Return the mean time to a picture of each segment that was shown, in its rung, by a viewer who goes there
        then and has airgs.json alone: a round trip and tables, a round trip and files. Those that the trace ends before
        do not count; None if none is left, and over a real connection.
        """
        took, offers, link = list[float](), self.offers, self.link
        for shown in self.shown:
            if link is None or shown.rung is None:
                continue
            at_s = shown.start_s
            with suppress(TransportError):
                for paths in offers.sought(shown.segment, shown.rung):
                    at_s = link.arrival_s(offers.wire_bytes(paths), at_s + link.rtt_s)
                took.append(at_s + self.settings.decode_frame_s - shown.start_s)
        return float(np.mean(took)) if took else None

    @property
    def mean_quality(self) -> float:
        """Return the mean PSNR in dB over media time, as `session_bound` counts it, without lost segments."""
        shown = [(s.psnr, s.frames) for s in self.shown if s.psnr is not None]
        return sum(p * n for p, n in shown) / sum(n for _, n in shown)


def _fetch(offers: Offers, event: Arrived) -> Fetch:
    """Return the record of a batch. All bytes of a replacement are wasted until it is shown."""
    arrival, request = event.arrival, event.arrival.request
    wasted = max(0, arrival.bytes - offers.wire_bytes(arrival.usable))
    if request.kind is BatchKind.REPLACEMENT:
        wasted = arrival.bytes
    elif arrival.complete:
        wasted = sum(retry.bytes for retry in arrival.retries)
    asked = request.kind, request.position, request.rung
    sizes = len(arrival.whole) + len(arrival.refused), len(arrival.retries), arrival.bytes, wasted
    rates = request.sent_s, arrival.at_s, event.budget_bytes, event.throughput_bps
    decision, shown = event.decision, arrival.complete and request.kind in NEXT
    return Fetch(*asked, *sizes, *rates, decision.fits, arrival.abandoned, shown, decision.reason)


# Those that studies compare; with `regret`, the PSNR under the bound for the same moments.
FIGURES = (
    *("psnr_mean", "psnr_p5", "stall_ratio", "startup_s", "switches", "bytes_per_frame", "regret", "change_db"),
    *("qoe", "wasted", "utilisation", *(f"{kind}_kb_frame" for kind in FileKind)),
)

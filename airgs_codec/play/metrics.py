"""What a session was like: figures over the batches that were fetched and the segments that were shown, and what they
are called in tables.

PSNR has three definitions in this package. Packages: the PSNR of the squared error pooled over views and frames.
Training: the mean over views of each view's dB. Sessions, here: every segment has the package's PSNR of its rung, and
a session the mean of these dB over display ticks.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.package.layout import FileKind
from airgs_codec.play.downloader import BatchKind, Shown
from airgs_codec.play.fetcher import SHORTEST_S
from airgs_codec.play.offers import Offers
from airgs_codec.play.playout import screen_ticks
from airgs_codec.play.policies.state import STALL_DB
from airgs_codec.play.trace import Link


@dataclass(frozen=True, slots=True)
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
    """Figures of one session. Frames of lost segments have no quality: they are counted apart and not in PSNR."""

    frames: int
    played_s: float
    startup_s: float  # from the first request to the first picture
    startup_requests: int  # up to those of the files of the first picture
    startup_bytes: int  # of the answers to them, with headers
    startup_table_bytes: int  # of them, those of tables
    stalls: int
    stall_s: float  # waited after the first picture
    stall_ratio: float  # of the time from the first picture to the last
    switches: int  # changes of the rung from one segment to the next
    psnr_mean: float | None  # dB, mean over display ticks, frozen ones with the picture that stood
    psnr_p5: float | None  # dB, 5th percentile of the same
    delta_e_mean: float | None  # CIEDE2000, mean over display ticks as for psnr_mean
    change_db: float  # mean change of PSNR from one segment to the next
    qoe: float | None  # dB a segment: quality - changes - STALL_DB a second of waiting
    bytes: Mapping[str, int]  # by FileKind, of files that were of use, without headers
    bytes_per_frame: float
    wire_bytes: int  # everything that passed, with headers
    wasted: float  # share of wire_bytes
    utilisation: float | None  # wire_bytes as a share of what could have passed; None over a real connection
    replaced: int  # replacements that were fetched
    abandoned: int
    retries: int  # requests that got faulty answers, and were made again
    late: float  # share of segments that were waited for
    infeasible: float  # share of choices for which no rung fitted
    lost_frames: int
    frame_ms_mean: float  # ms that a frame was on its way, its share of the batch that brought it
    frame_ms_p50: float
    frame_ms_p95: float
    frame_ms_max: float
    rungs: Mapping[str, int]  # segments shown with each; "lost" counts the others
    gaussians: int  # most that a picture showed
    trace: str | None  # these are None over a real connection
    trace_mean_bps: float | None
    trace_scale: float | None
    trace_offset_s: float | None
    trace_end: str | None  # what follows the trace's last second
    trace_ended: bool | None  # whether the session was longer than the trace
    rtt_s: float | None

    def as_dict(self) -> dict[str, Any]:
        """All figures by name, as plain values."""
        return asdict(self)


def frame_times(fetches: Sequence[Fetch], shown: Sequence[Shown]) -> NDArray[np.float64]:
    """Seconds that every frame shown was on its way: its share of the batches that brought what was shown."""
    spans: dict[int, tuple[float, float]] = {}
    for f in fetches:
        if f.shown:
            first_s = f.request_s if f.kind is BatchKind.REPLACEMENT else spans.get(f.position, (f.request_s,))[0]
            spans[f.position] = first_s, f.arrival_s
    took = {position: last_s - first_s for position, (first_s, last_s) in spans.items()}
    frames = [shown[position].frames for position in took]
    return np.repeat([seconds / n for seconds, n in zip(took.values(), frames, strict=True)], frames)


def mean_quality(shown: Sequence[Shown]) -> float:
    """PSNR in dB, mean over media time; segments without a quality are left out."""
    known = [(s.psnr, s.frames) for s in shown if s.psnr is not None]
    return sum(p * n for p, n in known) / sum(n for _, n in known)


def _first_picture(fetches: Sequence[Fetch]) -> int:
    """The last batch that the first picture needs; the last of all where there is none."""
    brought = [i for i, f in enumerate(fetches) if f.shown and f.kind in (BatchKind.GROUP, BatchKind.STATE)]
    same = [i for i in brought if fetches[i].position == fetches[brought[0]].position]
    return same[-1] if same else len(fetches)


def session_metrics(
    offers: Offers,
    link: Link | None,
    fetches: Sequence[Fetch],
    shown: Sequence[Shown],
    bytes_by_kind: Mapping[FileKind, int],
) -> SessionMetrics:
    """All figures of a session; `link` is None over a real connection."""
    frames = sum(s.frames for s in shown)
    stalls = [s.stall_s for s in shown if s.stall_s > SHORTEST_S]
    played, stall = frames / offers.fps, math.fsum(stalls)
    on_screen = [shown[i] for i, _ in screen_ticks(shown, offers.fps)]
    psnr = np.array([s.psnr for s in on_screen if s.psnr is not None])
    found = [offers.offer(s.segment).rungs[s.rung] for s in shown if s.rung is not None]
    seen = [offers.offer(s.segment).rungs[s.rung] for s in on_screen if s.psnr is not None and s.rung is not None]
    quality = [s.psnr for s in shown if s.psnr is not None]
    changes = [abs(b - a) for a, b in itertools.pairwise(quality)]
    rungs = [s.rung for s in shown]
    names = offers.names
    counts = Counter("lost" if rung is None else names[rung] for rung in rungs)
    wire, end_s = sum(f.bytes for f in fetches), max(f.arrival_s for f in fetches)
    choices = [f.fits for f in fetches if f.kind in (BatchKind.GROUP, BatchKind.STATE)]
    took_ms = 1e3 * frame_times(fetches, shown)
    took_ms = took_ms if len(took_ms) else np.zeros(1)
    trace = link.trace if link else None
    first = fetches[: 1 + _first_picture(fetches)]
    return SessionMetrics(
        frames=frames,
        played_s=played,
        startup_s=shown[0].start_s,
        startup_requests=sum(f.files + f.retries for f in first),
        startup_bytes=sum(f.bytes for f in first),
        startup_table_bytes=sum(f.bytes for f in first if f.kind is BatchKind.TABLES),
        stalls=len(stalls),
        stall_s=stall,
        stall_ratio=stall / (played + stall),
        switches=sum(a != b for a, b in itertools.pairwise(rungs)),
        psnr_mean=float(psnr.mean()) if len(psnr) else None,
        psnr_p5=float(np.percentile(psnr, 5)) if len(psnr) else None,
        delta_e_mean=float(np.mean([rung.delta_e for rung in seen])) if seen else None,
        change_db=float(np.mean(changes)) if changes else 0.0,
        qoe=(sum(quality) - sum(changes) - STALL_DB * stall) / len(quality) if quality else None,
        bytes={kind.value: size for kind, size in bytes_by_kind.items()},
        bytes_per_frame=sum(bytes_by_kind.values()) / frames,
        wire_bytes=wire,
        wasted=sum(f.wasted for f in fetches) / wire,
        utilisation=wire / max(1.0, link.bytes_between(0.0, end_s)) if link else None,
        replaced=sum(f.kind is BatchKind.REPLACEMENT for f in fetches),
        abandoned=sum(f.abandoned for f in fetches),
        retries=sum(f.retries for f in fetches),
        late=len(stalls) / len(shown),
        infeasible=sum(not fits for fits in choices) / max(1, len(choices)),
        lost_frames=sum(s.frames for s in shown if s.rung is None),
        frame_ms_mean=float(took_ms.mean()),
        frame_ms_p50=float(np.percentile(took_ms, 50)),
        frame_ms_p95=float(np.percentile(took_ms, 95)),
        frame_ms_max=float(took_ms.max()),
        rungs=dict(counts.most_common()),
        gaussians=max((rung.gaussians for rung in found), default=0),
        trace=trace.name if trace else None,
        trace_mean_bps=trace.mean_bps if trace else None,
        trace_scale=trace.scale if trace else None,
        trace_offset_s=trace.offset_s if trace else None,
        trace_end=trace.end if trace else None,
        trace_ended=end_s > trace.duration_s if trace else None,
        rtt_s=link.rtt_s if link else None,
    )


TICK_PSNR = "mean over display ticks of the dB of what was on the screen; frozen pictures count"


@dataclass(frozen=True, slots=True)
class Figure:
    name: str  # in rows and records
    heading: str  # with the unit
    meaning: str
    factor: float = 1.0  # from the row's unit to the heading's
    digits: int = 2
    headline: bool = False  # one of those that pages and terminals show; CSV has all

    def text(self, value: float) -> str:
        """A value of a row in the heading's unit."""
        return f"{self.factor * value:.{self.digits}f}"


FIGURES = (
    Figure("psnr_mean", "PSNR dB", TICK_PSNR, headline=True),
    Figure("psnr_p5", "5th %ile dB", "5th percentile over display ticks of the same dB", headline=True),
    Figure("stall_ratio", "stalled %", "waiting after the first picture, of the time since", 100, headline=True),
    Figure("startup_s", "start-up s", "from the first request to the first picture", headline=True),
    Figure("switches", "switches", "changes of the rung from one segment to the next", 1, 1, headline=True),
    Figure("bytes_per_frame", "kB/frame", "files that were of use, without headers", 1e-3, headline=True),
    Figure("regret", "regret dB", "PSNR under the bound for the same moments, mean over media time", headline=True),
    Figure("change_db", "change dB", "mean change of PSNR from one segment to the next"),
    Figure("qoe", "QoE dB", "a segment: quality - changes - 20 dB for a second of waiting"),
    Figure("wasted", "wasted %", "bytes that served nothing, of those on the wire", 100, 1),
    Figure("utilisation", "used %", "bytes on the wire, of those that could have passed", 100, 0),
    Figure("infeasible", "no fit %", "choices for which no rung fitted", 100, 1),
    Figure("late", "late %", "segments that were waited for", 100, 1),
    Figure("frame_ms_mean", "mean ms", "time a frame was on its way: its share of the batch that brought it", 1, 0),
    Figure("frame_ms_p50", "median ms", "median over frames of the same time", 1, 0),
    Figure("frame_ms_p95", "95 % ms", "95th percentile over frames of the same time", 1, 0),
    Figure("frame_ms_max", "worst ms", "the longest of these times", 1, 0),
    *(Figure(f"{kind}_kb_frame", f"{kind} kB", f"kB a frame of {kind} files, without headers") for kind in FileKind),
)


def headlines(figures: tuple[Figure, ...]) -> list[Figure]:
    """The figures that pages and terminals show."""
    return [figure for figure in figures if figure.headline]


def meanings(figures: tuple[Figure, ...]) -> dict[str, str]:
    """Name of every figure -> what it means."""
    return {figure.name: figure.meaning for figure in figures}

"""Policies compared on the same links: every trace from several seeded offsets, paired, with bootstrap intervals.

Bandwidth is taken as given whatever a policy does (replay), so cross traffic that would have reacted is not modelled.
"""

from __future__ import annotations

import math
import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import repeat
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from airgs_codec._report import Form, Table
from airgs_codec.errors import ConfigError, TransportError
from airgs_codec.package.layout import JSON_NAME, FileKind
from airgs_codec.package.package import open_package
from airgs_codec.play.metrics import FIGURES, QOE_WORDS
from airgs_codec.play.offers import NO_KEYFRAMES, Offers
from airgs_codec.play.player import TableStore
from airgs_codec.play.playout import SessionSettings
from airgs_codec.play.policies import DEFAULT_POLICY, ORACLES
from airgs_codec.play.session import session_bound, simulate
from airgs_codec.play.trace import Link, Trace
from airgs_codec.progress import Progress, silent

FEASIBLE_START_S = 2.0  # start-up by which the smallest rungs must play without a stall
RESAMPLES = 2000
NOT_SEEN = "No difference found"  # beyond its error
SURE_TRACES = 6  # with fewer, all on one side are chance more than once in twenty times (sign test)
Row = dict[str, Any]  # what is known of one session or run, by name
HEADLINES: dict[str, tuple[str, Form]] = {
    "policy": ("policy", ""), "psnr_mean": ("PSNR dB", ".2f"), "stall_ratio": ("stalled", ".2%"),
    "qoe": ("QoE dB", ".2f"), "psnr_p5": ("5th %ile dB", ".2f"), "startup_s": ("start-up s", ".2f"),
    "switches": ("switches", ".1f"), "bytes_per_frame": ("kB/frame", lambda size: f"{size / 1e3:.2f}"),
    "regret": ("regret dB", ".2f"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class StudySettings:
    policies: tuple[str, ...]
    traces: tuple[str, ...]  # as `Trace.open` takes them
    offsets: int = 8  # of each trace, drawn from `seed`
    scale: float = 1.0
    end: str = "loop"
    rtt_s: float | None = None  # None: the trace's own, else DEFAULT_RTT_S
    seed: int = 1
    session: SessionSettings = field(default_factory=SessionSettings)
    jobs: int = 1

    def __post_init__(self) -> None:
        if not self.policies or len(set(self.policies)) != len(self.policies):
            raise ConfigError(f"policies: expected different ones, got {', '.join(self.policies) or 'none'}")
        if not self.traces:
            raise ConfigError("traces: expected at least one")
        if self.offsets < 1 or self.jobs < 1 or self.seed < 0:
            raise ConfigError("expected at least one offset and one job, and a seed of 0 or more")


@dataclass(frozen=True, slots=True, eq=False)
class Study:
    """Rows of every session, in the order of traces, offsets and policies."""

    settings: StudySettings
    package: str
    rows: tuple[Row, ...]

    def of(self, policy: str, figure: str, feasible: bool | None = None) -> NDArray[np.float64]:
        """Return a figure of all sessions of a policy, (n,), NaN where there is none, on links `feasible` or not."""
        rows = [r for r in self.rows if r["policy"] == policy and (feasible is None or r["feasible"] == feasible)]
        return np.array([math.nan if r[figure] is None else float(r[figure]) for r in rows])


def offsets_of(trace: Trace, count: int, seed: int) -> list[float]:
    """Return where sessions begin in a trace: drawn from the seed and the trace's name, to the millisecond."""
    random = np.random.default_rng([seed, *trace.name.encode()])
    return [round(float(v), 3) for v in random.uniform(0, trace.duration_s, count)]


def is_feasible(c: Offers, link: Link, settings: SessionSettings, loops: int) -> bool:
    """Return whether a player of the smallest rungs alone shows all without a stall from FEASIBLE_START_S on."""
    due, at = FEASIBLE_START_S, 0.0
    for tables in ([JSON_NAME], TableStore(c).missing(range(1))):
        at = link.arrival_s(c.wire_bytes(tables), at + link.rtt_s)
    for position in range(loops * c.segments):
        offer = c.offer(c.place(position)[1])
        room = due + offer.seconds - settings.buffer_s
        asked = max(at - link.rtt_s if settings.pipelined and position else at, room)
        at = link.trace.arrival_s(min(offer.sizes(NO_KEYFRAMES)), max(at, asked + link.rtt_s))
        if at + settings.decode_frame_s > due:
            return False
        due += offer.seconds
    return True


def run_study(package: str | Path, settings: StudySettings, progress: Progress = silent) -> Study:
    """Play every policy on every link, `settings.jobs` traces at a time.

    Raises TransportError for a trace that cannot be read or ends too soon, ConfigError, FormatError.
    """
    for trace in settings.traces:
        Trace.open(trace)  # refuses one that cannot be read before minutes of work
    rows: list[Row] = []
    progress("sessions", 0, len(settings.traces))
    # A fork has no threads, and clients of object stores live on them.
    with ProcessPoolExecutor(settings.jobs, multiprocessing.get_context("spawn")) as pool:
        for done, some in enumerate(pool.map(sessions, repeat(package), settings.traces, repeat(settings)), 1):
            rows += some
            progress("sessions", done, len(settings.traces))
    return Study(settings, Path(package).name, tuple(rows))


def sessions(package: str | Path | Offers, name: str, settings: StudySettings) -> list[Row]:
    """Return a row for every session over a trace."""
    c = package if isinstance(package, Offers) else Offers.of(open_package(package))
    whole, rows = Trace.open(name), []
    rules = replace(settings.session, loops=c.loops(settings.session.loops))
    for offset in offsets_of(whole, settings.offsets, settings.seed):
        trace = replace(whole.cut(offset, settings.scale), end=settings.end)
        link = Link.over(trace, settings.rtt_s)
        try:
            feasible = is_feasible(c, link, rules, c.loops(rules.loops))
        except TransportError:  # the trace is over first
            feasible = False
        about = {"offset_s": offset, "scale": settings.scale, "mean_bps": trace.mean_bps, "rtt_s": link.rtt_s}
        for policy in settings.policies:
            log = simulate(c, link, policy, rules)
            bound, frames = session_bound(log), log.metrics.frames
            row = {"trace": trace.name, **about, "policy": policy, "feasible": feasible}
            row |= log.metrics.as_dict() | {"bound": bound}
            row["regret"] = None if bound is None else bound - log.mean_quality
            rows.append(row | {f"{k}_kb_frame": log.bytes_by_kind.get(k, 0) / frames / 1e3 for k in FileKind})
    return rows


class Interval(NamedTuple):
    """A mean and its 95 % interval."""

    mean: float
    low: float
    high: float

    def sign(self, groups: Sequence[str]) -> int:
        """Return 1 or -1 where a mean is beyond its error, over enough different groups, else 0."""
        return (len(set(groups)) >= SURE_TRACES) * ((self.low > 0) - (self.high < 0))


def interval(values: NDArray[np.float64], groups: Sequence[str]) -> Interval:
    """Return mean and 95 % interval by percentile bootstrap over whole traces, whose offsets are not independent.

    values (n,), NaN where there is no figure; groups (n,) name the trace of each. All NaN where nothing is known.
    """
    names, member = np.unique(groups, return_inverse=True)
    finite = np.isfinite(values)
    if not finite.any():
        return Interval(math.nan, math.nan, math.nan)
    sums = np.bincount(member[finite], values[finite], len(names))
    counts = np.bincount(member[finite], minlength=len(names)).astype(np.float64)
    picks = np.random.default_rng(0).integers(0, len(names), (RESAMPLES, len(names)))
    drawn = counts[picks].sum(axis=1)
    means = sums[picks].sum(axis=1)[drawn > 0] / drawn[drawn > 0]
    low, high = np.percentile(means, [2.5, 97.5])
    return Interval(float(sums.sum() / counts.sum()), float(low), float(high))


def summarise(study: Study, feasible: bool | None = None) -> list[Row]:
    """Return a row for each policy, over all links, or over those whose smallest rungs are `feasible` or not.

    `figures` are intervals by their names.
    """
    policies = study.settings.policies
    traces = [r["trace"] for r in study.rows if r["policy"] == policies[0] and feasible in (None, r["feasible"])]
    return [
        {"policy": policy, "sessions": len(traces)}
        | {"figures": {name: interval(study.of(policy, name, feasible), traces) for name in FIGURES}}
        for policy in policies
    ]


def study_record(study: Study) -> dict[str, Any]:
    tables = {"all": summarise(study), "feasible": summarise(study, True)}
    return {"package": study.package, "answer": study_answer(study), **tables}


def format_study(study: Study) -> str:
    """Return headline figures on all links, and on those that the smallest rungs fit, and which policy to take."""
    record = study_record(study)
    lines = [conditions(study), "PSNR: dB of a session, mean over display ticks; --json has all figures", ""]
    words = f"links whose smallest rungs play without a stall from {FEASIBLE_START_S:g} s on:"
    for rows, kind in ((record["all"], "links in all:"), (record["feasible"], words)):
        means = [{"policy": row["policy"], **{name: row["figures"][name].mean for name in FIGURES}} for row in rows]
        if count := rows[0]["sessions"]:
            means.sort(key=lambda row: -float(np.nan_to_num(row["qoe"])))
            lines += [f"{count} {kind}", Table("", means, HEADLINES).to_text(), ""]
    return "\n".join([*lines, *record["answer"].values()])


def conditions(study: Study) -> str:
    s, first = study.settings, study.rows[0]
    rates, trips = ([row[name] for row in study.rows] for name in ("mean_bps", "rtt_s"))
    return (
        f"{study.package}: {first['frames']} frames ({first['played_s']:.1f} s) over {len(s.traces)} traces, "
        f"{s.offsets} offsets each (seed {s.seed}), rates x{s.scale:g}, means of {min(rates) / 1e6:.1f} to "
        f"{max(rates) / 1e6:.1f} Mbit/s, after the end: {s.end}, round trip {1e3 * min(trips):.0f} to "
        f"{1e3 * max(trips):.0f} ms, buffer {s.session.buffer_s:g} s"
    )


def study_answer(study: Study) -> dict[str, str]:
    """Return which policy these links speak for, in whole sentences by the keys of HEADS; oracles are no players."""
    policies = study.settings.policies
    players = [p for p in policies if p not in ORACLES] or list(policies)
    measured = any(row["qoe"] is not None for row in study.rows)
    # Where quality was not measured, only waiting counts.
    goodness = {p: study.of(p, "qoe") if measured else -100 * study.of(p, "stall_ratio") for p in players}
    best, *_ = ranked = sorted(players, key=lambda p: -float(np.nan_to_num(goodness[p]).mean()))
    traces = [row["trace"] for row in study.rows if row["policy"] == best]

    def lead(one: str, other: str) -> Interval:
        return interval(goodness[one] - goodness[other], traces)

    take = DEFAULT_POLICY if DEFAULT_POLICY in players and lead(best, DEFAULT_POLICY).sign(traces) < 1 else best
    waits, mean_db = 100 * study.of(take, "stall_ratio").mean(), interval(study.of(take, "psnr_mean"), traces).mean
    shows = f"shows {mean_db:.1f} dB and" if measured else "shows what was not measured, and"
    good = [f"{take} {shows} waits {waits:.1f} % of the time on {len(traces)} links."]
    for other in [p for p in ranked if p != take][:1]:
        found = lead(take, other)
        words = f"Its QoE ({QOE_WORDS}) is {found.mean:.2f} dB above that of"
        words = f"{words if measured else f'It waits {found.mean:.1f} % less than'} {other}, the next"
        words = words if found.sign(traces) > 0 else f"{NOT_SEEN} to {other}"
        good.append(f"{words} ({found.low:.2f} to {found.high:.2f} over traces).")
    change = f"Stay with {take}, the default." if take == DEFAULT_POLICY else f"Play with --policy {take}."
    if len(set(traces)) < SURE_TRACES and len(players) > 1:
        change = f"Give {SURE_TRACES} --traces or more: fewer tell nothing for sure. {change}"
    wrong = "The smallest rungs play on all links."
    if len(hard := 100 * study.of(take, "stall_ratio", False)):
        wrong = (
            f"On {len(hard)} of {len(traces)} links even the smallest rungs stall, begun after {FEASIBLE_START_S:g} s, "
            f"and {take} waits {hard.mean():.1f} % of the time: encode a lower level (airgs-encode --levels)."
        )
    return {"good": " ".join(good), "wrong": wrong, "change": change}

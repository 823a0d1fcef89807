"""Policies compared on the same links: every trace from several seeded offsets, paired, with bootstrap intervals.

Bandwidth is taken as given whatever a policy does (replay), so cross traffic that would have reacted is not modelled.
"""

from __future__ import annotations

import math
import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from airgs_codec._report import Form, Table, listed
from airgs_codec.errors import ConfigError, TransportError
from airgs_codec.package.layout import JSON_NAME, FileKind
from airgs_codec.package.package import open_package
from airgs_codec.play.fetcher import TableStore
from airgs_codec.play.metrics import FIGURES, HEADLINES
from airgs_codec.play.offers import NONE, Offers
from airgs_codec.play.playout import SessionSettings
from airgs_codec.play.policies import DEFAULT_POLICY, ORACLES
from airgs_codec.play.session import session_bound, simulate
from airgs_codec.play.trace import Link, Trace
from airgs_codec.progress import Progress, silent

FEASIBLE_START_S = 2.0  # start-up by which the smallest rungs must play without a stall
RESAMPLES = 2000
SURE_TRACES = 6  # with fewer, all on one side are chance more than once in twenty times (sign test)
Row = dict[str, Any]  # what is known of one session or run, by name


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
            got = f"{self.offsets}, {self.jobs} and {self.seed}"
            raise ConfigError(f"expected at least one offset and job, and a seed of 0 or more, got {got}")


@dataclass(frozen=True, slots=True, eq=False)
class Study:
    """Rows of every session, in the order of traces, offsets and policies."""

    settings: StudySettings
    package: str
    rows: tuple[Row, ...]
    rungs: tuple[str, ...] = ()  # of the package, by their names

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
    at = link.arrival_s(c.wire_bytes([JSON_NAME]), 0.0)
    due = FEASIBLE_START_S
    at = link.arrival_s(c.wire_bytes(TableStore(c).missing(range(1))), at)
    for position in range(loops * c.segments):
        offer = c.offer(c.place(position)[1])
        room = due + offer.seconds - settings.buffer_s
        asked = max(at - link.rtt_s if settings.pipelined and position else at, room)
        at = link.trace.arrival_s(min(offer.sizes(NONE)), max(at, asked + link.rtt_s))
        if at + settings.decode_frame_s > due:
            return False
        due += offer.seconds
    return True


def run_study(package: str | Path, settings: StudySettings, progress: Progress = silent) -> Study:
    """Play every policy on every link, `settings.jobs` traces at a time.

    Raises TransportError for a trace that cannot be read or ends too soon, ConfigError, FormatError.
    """
    for trace in settings.traces:
        Trace.open(trace)  # one that cannot be read is told before minutes of work
    rows: list[Row] = []
    tasks = [(package, trace, settings) for trace in settings.traces]
    progress("sessions", 0, len(tasks))
    context = multiprocessing.get_context("spawn")  # a fork has no threads, and clients of object stores live on them
    with ProcessPoolExecutor(settings.jobs, context) as pool:
        for done, some in enumerate(pool.map(_one_trace, tasks), 1):
            rows += some
            progress("sessions", done, len(tasks))
    return Study(settings, Path(package).name, tuple(rows), tuple(Offers.of(open_package(package)).names))


def _one_trace(task: tuple[str | Path, str, StudySettings]) -> list[Row]:
    path, name, settings = task
    c, whole, rows = Offers.of(open_package(path)), Trace.open(name), []
    rules = replace(settings.session, loops=c.loops(settings.session.loops))
    for offset in offsets_of(whole, settings.offsets, settings.seed):
        trace = whole.cut(offset, settings.scale).ending(settings.end)
        link = Link.over(trace, settings.rtt_s)
        try:
            feasible = is_feasible(c, link, rules, c.loops(rules.loops))
        except TransportError:  # the trace is over first
            feasible = False
        start = {"trace": trace.name, "offset_s": offset, "scale": settings.scale, "mean_bps": trace.mean_bps}
        for policy in settings.policies:
            log = simulate(c, link, policy, rules)
            bound, frames = session_bound(log) if c.manifest.measured else None, log.metrics.frames
            rows.append(
                start
                | {"policy": policy, "feasible": feasible, **log.metrics.as_dict(), "bound": bound}
                | {"regret": None if bound is None else bound - log.mean_quality}
                | {f"{kind}_kb_frame": log.bytes_by_kind.get(kind, 0) / frames / 1e3 for kind in FileKind}
            )
    return rows


class Interval(NamedTuple):
    """A mean and its 95 % interval."""

    mean: float
    low: float
    high: float


def interval(values: NDArray[np.float64], groups: Sequence[str], seed: int = 0) -> Interval:
    """Return mean and 95 % interval by percentile bootstrap over whole traces, whose offsets are not independent.

    values (n,), NaN where there is no figure; groups (n,) name the trace of each. All NaN where nothing is known.
    """
    names = sorted(set(groups))
    member = np.array([names.index(g) for g in groups], np.intp)
    known = np.isfinite(values)
    if not known.any():
        return Interval(math.nan, math.nan, math.nan)
    sums = np.bincount(member[known], values[known], len(names))
    counts = np.bincount(member[known], minlength=len(names)).astype(np.float64)
    picks = np.random.default_rng(seed).integers(0, len(names), (RESAMPLES, len(names)))
    drawn = counts[picks].sum(axis=1)
    means = sums[picks].sum(axis=1)[drawn > 0] / drawn[drawn > 0]
    low, high = np.percentile(means, [2.5, 97.5])
    return Interval(float(sums.sum() / counts.sum()), float(low), float(high))


def summarise(study: Study, feasible: bool | None = None) -> list[Row]:
    """Return a row for each policy, over all links, or over those whose smallest rungs are `feasible` or not.

    Intervals of `figures` by their names, and of their `differences` to the study's first policy on the same links;
    `stall_share` is the waiting of all `sessions` together, of their time.
    """
    first = study.settings.policies[0]
    traces = [r["trace"] for r in study.rows if r["policy"] == first and feasible in (None, r["feasible"])]
    rows = []
    for policy in study.settings.policies:
        values = {name: study.of(policy, name, feasible) for name in FIGURES}
        stalls, played = (study.of(policy, name, feasible).sum() for name in ("stall_s", "played_s"))
        differences = {name: some - study.of(first, name, feasible) for name, some in values.items()}
        rows.append(
            {"policy": policy, "sessions": len(traces)}
            | {"figures": {name: interval(some, traces) for name, some in values.items()}}
            | {"differences": {name: interval(some, traces) for name, some in differences.items()}}
            | {"stall_share": float(stalls / (stalls + played)) if traces else math.nan}
        )
    return rows


def study_record(study: Study) -> dict[str, Any]:
    """Return all tables with the meaning of every figure; what is not known is NaN, and null in JSON."""
    record = {"package": study.package, "answer": study_answer(study), "figures": FIGURES}
    return record | {"all": summarise(study), "feasible": summarise(study, True)}


def format_study(study: Study) -> str:
    """Return headline figures on all links, and on those that the smallest rungs fit, and which policy to take."""
    record = study_record(study)
    lines = [conditions(study), "PSNR: dB of a session, mean over display ticks; --json has all figures", ""]
    words = f"links whose smallest rungs play without a stall from {FEASIBLE_START_S:g} s on:"
    columns: dict[str, tuple[str, Form]] = {"policy": ("policy", "")}
    columns |= {name: (heading, digits) for name, (heading, _, digits) in HEADLINES.items()}
    for rows, kind in ((record["all"], "links:"), (record["feasible"], words)):
        factors = {name: factor for name, (_, factor, _) in HEADLINES.items()}
        means = [row | {name: factor * row["figures"][name].mean for name, factor in factors.items()} for row in rows]
        if count := rows[0]["sessions"]:
            all_ = "all " if rows is record["all"] else ""
            lines += [f"{all_}{count} {kind}", Table("", means, columns).to_text(), ""]
    return "\n".join([*lines, *filter(None, record["answer"].values())])


def conditions(study: Study) -> str:
    """Return what was played over what, in a sentence."""
    s, first = study.settings, study.rows[0]
    rates = [bps / 1e6 for bps in {r["trace"]: r["mean_bps"] for r in study.rows}.values()]
    trips = sorted({f"{1e3 * row['rtt_s']:.0f}" for row in study.rows}, key=float)
    return (
        f"{study.package}: {first['frames']} frames ({first['played_s']:.1f} s) over {len(rates)} traces, {s.offsets} "
        f"offsets each (seed {s.seed}), {'unscaled' if s.scale == 1 else f'rates x{s.scale:g}'}, means of "
        f"{min(rates):.1f} to {max(rates):.1f} Mbit/s, after the end: {s.end}, round trip {' to '.join(trips)} ms, "
        f"buffer {s.session.buffer_s:g} s"
    )


def study_answer(study: Study) -> dict[str, str]:
    """Return which policy these links speak for, in whole sentences by the keys of HEADS; oracles are no players."""
    policies = study.settings.policies
    players = [p for p in policies if p not in ORACLES] or list(policies)
    measured = any(row["qoe"] is not None for row in study.rows)
    # Where quality was not measured, waiting alone tells.
    goodness = {p: study.of(p, "qoe") if measured else -100 * study.of(p, "stall_ratio") for p in players}
    best, *others = sorted(players, key=lambda p: -float(np.nan_to_num(goodness[p]).mean()))
    traces = [row["trace"] for row in study.rows if row["policy"] == best]

    def lead(other: str) -> tuple[Interval, str]:
        found = interval(goodness[best] - goodness[other], traces)
        return found, "" if len(set(traces)) >= SURE_TRACES and found.low > 0 else ", which may be chance"

    waits, psnr = 100 * study.of(best, "stall_ratio").mean(), study.of(best, "psnr_mean")
    shows = (
        f"it shows {interval(psnr, traces).mean:.1f} dB and" if measured else "what it shows was not measured, and it"
    )
    good, change = [f"{best} does best on {len(traces)} links: {shows} waits {waits:.1f} % of the time."], []
    if others:
        found, chance = lead(others[0])
        words = f"Its QoE (quality less changes and 20 dB for a second of waiting) is {found.mean:.2f} dB above that of"
        words = words if measured else f"It waits {found.mean:.1f} % less than"
        good.append(f"{words} {others[0]}, the next ({found.low:.2f} to {found.high:.2f} over traces{chance}).")
    if best == DEFAULT_POLICY:
        change.append(f"Stay with {DEFAULT_POLICY}, the default.")
    elif DEFAULT_POLICY not in players or not lead(DEFAULT_POLICY)[1]:
        change.append(f"Play with --policy {best}.")
    else:
        change.append(f"Give more --traces: the lead over {DEFAULT_POLICY}, the default, may be chance here.")
    wrong = "The smallest rungs play on all links."
    if len(hard := 100 * study.of(best, "stall_ratio", False)):
        wrong = (
            f"On {len(hard)} of {len(traces)} links no policy helps: there even the smallest rungs stall, begun after "
        )
        wrong += f"{FEASIBLE_START_S:g} s, and {best} waits {hard.mean():.1f} % of the time."
        change.append("For links that carry too little, encode a lower level (airgs-encode --levels).")
    seen = {name for row in study.rows for name in row["rungs"]}
    unseen = [name for name in study.rungs if name not in seen]
    return {
        "good": " ".join(good),
        "wrong": wrong,
        "useless": f"No policy showed {listed(unseen)} on any of these links." if unseen else "",
        "change": " ".join(change),
    }

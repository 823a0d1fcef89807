"""Policies compared on the same links: every trace from several seeded offsets, paired, with bootstrap intervals.

Bandwidth is taken as given whatever a policy does (replay), so cross traffic that would have reacted is not modelled.
"""

from __future__ import annotations

import math
import multiprocessing
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from airgs_codec._report import listed, table
from airgs_codec.errors import ConfigError, TransportError
from airgs_codec.package.layout import JSON_NAME, FileKind
from airgs_codec.package.package import open_package
from airgs_codec.places.whole import to_json
from airgs_codec.play.fetcher import TableStore
from airgs_codec.play.metrics import FIGURES, HEADLINES
from airgs_codec.play.offers import NONE, Offers
from airgs_codec.play.playout import SessionSettings
from airgs_codec.play.policies import DEFAULT_POLICY, ORACLES
from airgs_codec.play.session import SessionLog, session_bound, simulate
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
        """(n,) a figure of every session of a policy, NaN where it has none, on links that are `feasible` or not."""
        rows = [r for r in self.rows if r["policy"] == policy and (feasible is None or r["feasible"] == feasible)]
        return np.array([math.nan if r[figure] is None else float(r[figure]) for r in rows])


def offsets_of(trace: Trace, count: int, seed: int) -> list[float]:
    """Where sessions begin in a trace: drawn from the seed and the trace's name, to the millisecond."""
    random = np.random.default_rng([seed, *trace.name.encode()])
    return [round(float(v), 3) for v in random.uniform(0, trace.duration_s, count)]


def is_feasible(c: Offers, link: Link, settings: SessionSettings, loops: int) -> bool:
    """Whether a player that always takes the smallest rung shows all of it without a stall from FEASIBLE_START_S on."""
    at = link.arrival_s(c.wire_bytes([JSON_NAME]), 0.0)
    due = FEASIBLE_START_S
    at = link.arrival_s(c.wire_bytes(TableStore(c).missing(range(1))), at)
    for position in range(loops * c.segments):
        offer = c.offer(c.place(position)[1])
        room = due + offer.seconds - settings.buffer_s
        asked = max(at - link.rtt_s if settings.pipelined and position else at, room)
        size = min(offer.sizes(NONE))
        at = link.trace.arrival_s(size, max(at, asked + link.rtt_s))
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
    c = Offers.of(open_package(path))
    whole = Trace.open(name)
    rules = replace(settings.session, loops=c.loops(settings.session.loops))
    rows = []
    for offset in offsets_of(whole, settings.offsets, settings.seed):
        trace = whole.cut(offset, settings.scale).ending(settings.end)
        link = Link.over(trace, settings.rtt_s)
        start = {"trace": trace.name, "offset_s": offset, "scale": settings.scale, "mean_bps": trace.mean_bps}
        feasible = _is_feasible_to_the_end(c, link, rules)
        for policy in settings.policies:
            log = simulate(c, link, policy, rules)
            rows.append(start | {"policy": policy, "feasible": feasible} | _session_row(log))
    return rows


def _is_feasible_to_the_end(c: Offers, link: Link, rules: SessionSettings) -> bool:
    try:
        return is_feasible(c, link, rules, c.loops(rules.loops))
    except TransportError:  # the trace is over first
        return False


def _session_row(log: SessionLog) -> Row:
    bound = session_bound(log) if log.offers.manifest.measured else None
    shown = sum(s.frames for s in log.shown)
    return (
        log.metrics.as_dict()
        | {"bound": bound, "regret": None if bound is None else bound - log.mean_quality}
        | {f"{kind}_kb_frame": log.bytes_by_kind.get(kind, 0) / shown / 1e3 for kind in FileKind}
    )


class Interval(NamedTuple):
    """A mean and its 95 % interval."""

    mean: float
    low: float
    high: float


def interval(values: NDArray[np.float64], groups: Sequence[str], seed: int = 0) -> Interval:
    """Mean and 95 % interval by percentile bootstrap over whole traces, whose offsets are not independent.

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


@dataclass(frozen=True, slots=True)
class PolicySummary:
    """Every figure of a policy over the sessions of a study."""

    policy: str
    sessions: int
    figures: Mapping[str, Interval]  # by name in FIGURES
    differences: Mapping[str, Interval]  # to the study's first policy on the same links
    stall_share: float  # waiting of all sessions together, of their time


def summarise(study: Study, feasible: bool | None = None) -> list[PolicySummary]:
    """One summary a policy, over all links, or over those whose smallest rungs are `feasible` or not."""
    first = study.settings.policies[0]
    traces = [r["trace"] for r in study.rows if r["policy"] == first and feasible in (None, r["feasible"])]
    summaries = []
    for policy in study.settings.policies:
        values = {name: study.of(policy, name, feasible) for name in FIGURES}
        stalls, played = (study.of(policy, name, feasible).sum() for name in ("stall_s", "played_s"))
        summaries.append(
            PolicySummary(
                policy=policy,
                sessions=len(traces),
                figures={name: interval(v, traces) for name, v in values.items()},
                differences={name: interval(v - study.of(first, name, feasible), traces) for name, v in values.items()},
                stall_share=float(stalls / (stalls + played)) if traces else math.nan,
            )
        )
    return summaries


def study_record(study: Study) -> dict[str, Any]:
    """All tables with the meaning of every figure; what is not known is NaN, and null in JSON."""
    return {
        "package": study.package,
        "answer": study_answer(study),
        "figures": FIGURES,
        "all": [asdict(summary) for summary in summarise(study)],
        "feasible": [asdict(summary) for summary in summarise(study, True)],
    }


def format_study(study: Study, as_json: bool = False) -> str:
    """The headline figures on all links, and on those whose smallest rungs are feasible, and which policy to take."""
    if as_json:
        return to_json(study_record(study))
    everything, feasible = summarise(study), summarise(study, True)
    lines = [conditions(study), "PSNR: dB of a session, mean over display ticks; --json has all figures", ""]
    lines += [f"all {everything[0].sessions} links:", *_summary_lines(everything), ""]
    if count := feasible[0].sessions:
        words = f"{count} links whose smallest rungs play without a stall from {FEASIBLE_START_S:g} s on:"
        lines += [words, *_summary_lines(feasible), ""]
    return "\n".join([*lines, *filter(None, study_answer(study).values())])


def _summary_lines(summaries: Sequence[PolicySummary]) -> list[str]:
    cells = []
    for s in summaries:
        means = [(factor * s.figures[name].mean, digits) for name, (_, factor, digits) in HEADLINES.items()]
        cells.append([s.policy, *("-" if np.isnan(mean) else format(mean, digits) for mean, digits in means)])
    return table(["policy", *(heading for heading, _, _ in HEADLINES.values())], cells)


def conditions(study: Study) -> str:
    """Return what was played over what, in a sentence."""
    s = study.settings
    means = {r["trace"]: r["mean_bps"] for r in study.rows}
    rates = [bps / 1e6 for bps in means.values()]
    scale = "unscaled" if s.scale == 1 else f"rates x{s.scale:g}"
    trips = sorted({round(1e3 * r["rtt_s"]) for r in study.rows})
    trip = f"{trips[0]}" if len(trips) == 1 else f"{trips[0]}-{trips[-1]}"
    frames, seconds = study.rows[0]["frames"], study.rows[0]["played_s"]
    return (
        f"{study.package}: {frames} frames ({seconds:.1f} s) over {len(means)} traces, {s.offsets} offsets each "
        f"(seed {s.seed}), {scale}, means {min(rates):.1f}-{max(rates):.1f} Mbit/s (median {np.median(rates):.1f}), "
        f"after the end: {s.end}, round trip {trip} ms, buffer {s.session.buffer_s:g} s"
    )


def study_answer(study: Study) -> dict[str, str]:
    """Which policy these links speak for, in whole sentences by what they tell; oracles are no players."""
    players = [p for p in study.settings.policies if p not in ORACLES] or list(study.settings.policies)
    goodness = {p: _goodness(study, p) for p in players}
    ranked = sorted(players, key=lambda p: -float(np.nan_to_num(goodness[p]).mean()))
    best, links = ranked[0], len(goodness[ranked[0]])
    psnr, waited, regret = (_mean(study.of(best, name)) for name in ("psnr_mean", "stall_ratio", "regret"))
    shows = f"it shows {psnr:.1f} dB and" if _is_measured(study) else "what it shows was not measured, and it"
    good = f"{best} does best on {links} links: {shows} waits {100 * waited:.1f} % of the time."
    if len(ranked) > 1:
        good += f" {_lead(study, best, ranked[1])}"
        good += f" {ranked[-1]} is the last of {len(ranked)}." if len(ranked) > 2 else ""
    shown = {name for row in study.rows for name in row["rungs"]}
    unseen = [name for name in study.rungs if name not in shown]
    return {
        "good": good,
        "wrong": _wrong(study, best, regret),
        "useless": f"No policy showed {listed(unseen)} on any of these links." if unseen else "",
        "change": _advice(study, best),
    }


def _is_measured(study: Study) -> bool:
    return any(row["qoe"] is not None for row in study.rows)


def _mean(values: NDArray[np.float64]) -> float:
    """The mean of those that are not NaN; NaN where all are."""
    known = values[~np.isnan(values)]
    return float(known.mean()) if known.size else math.nan


def _goodness(study: Study, policy: str) -> NDArray[np.float64]:
    """(n,) QoE of a policy's sessions in dB; where quality was not measured, the share of time that nobody waited."""
    return study.of(policy, "qoe") if _is_measured(study) else 1 - study.of(policy, "stall_ratio")


def _difference(study: Study, a: str, b: str) -> Interval:
    """By how much the `_goodness` of one policy is above that of another on the same links."""
    traces = [row["trace"] for row in study.rows if row["policy"] == a]
    return interval(_goodness(study, a) - _goodness(study, b), traces)


def _is_sure(study: Study, difference: Interval) -> bool:
    """Whether a difference is one on other traces, too."""
    return len({row["trace"] for row in study.rows}) >= SURE_TRACES and difference.low > 0


def _lead(study: Study, best: str, other: str) -> str:
    lead = _difference(study, best, other)
    sure = "" if _is_sure(study, lead) else ", which may be chance"
    if not _is_measured(study):
        mean, low, high = (100 * share for share in lead)
        return f"{other}, the next, waits {mean:.1f} % more ({low:.1f} to {high:.1f} over traces{sure})."
    return (
        f"Its QoE (quality less changes and 20 dB for a second of waiting) is {lead.mean:.2f} dB above that of "
        f"{other}, the next ({lead.low:.2f} to {lead.high:.2f} over traces{sure})."
    )


def _wrong(study: Study, best: str, regret: float) -> str:
    """Where the best policy waits, whether another could do better, and what it does not show."""
    hard, easy = (100 * study.of(best, "stall_ratio", feasible) for feasible in (False, True))
    told = []
    if len(hard):
        told.append(
            f"On {len(hard)} of {len(hard) + len(easy)} links no policy helps: there even the smallest rungs, begun "
            f"after {FEASIBLE_START_S:g} s, stall, and {best} waits {hard.mean():.1f} % of the time."
        )
    if easy.size and easy.mean() > 0:
        told.append(f"Where the smallest rungs would not stall it still waits {easy.mean():.1f} % of the time.")
    if regret > 0:
        told.append(f"It shows {regret:.1f} dB less than the most that a player could at the same moments.")
    return " ".join(told) or f"Nothing: nobody waits{', and no player could show more' if regret <= 0 else ''}."


def _advice(study: Study, best: str) -> str:
    """What to play with, and whether other rungs or more links are needed."""
    told = []
    known = DEFAULT_POLICY in study.settings.policies
    if best == DEFAULT_POLICY:
        told.append(f"Stay with {DEFAULT_POLICY}, the default.")
    elif not known or _is_sure(study, _difference(study, best, DEFAULT_POLICY)):
        told.append(f"Play with --policy {best}.")
    else:
        lead = _difference(study, best, DEFAULT_POLICY).mean
        more = f"{lead:.2f} dB more" if _is_measured(study) else f"{100 * lead:.1f} % less waiting"
        told.append(f"Give more --traces: {more} than {DEFAULT_POLICY}, the default, may be chance here.")
    if (~np.array([row["feasible"] for row in study.rows], bool)).any():
        told.append("For links that carry too little, encode a lower level (airgs-encode --levels).")
    return " ".join(told)

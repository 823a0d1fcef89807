"""A study as text, as CSV and JSON, and as a page: which policy to take, and the figures of all of them."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec._report import BLUE, GREY, ORANGE, Page, Picture, html_table, listed, report_folder, table
from airgs_codec.places.whole import to_json, write_json
from airgs_codec.play.metrics import FIGURES, Figure, headlines, meanings
from airgs_codec.play.policies.named import DEFAULT_POLICY, ORACLES
from airgs_codec.play.study import FEASIBLE_START_S, Interval, PolicySummary, Row, Study, interval, summarise

PSNR_COLUMNS = {  # headings of the table of single sessions: which PSNR it is
    "psnr_mean": "psnr_mean_over_ticks_db",
    "psnr_p5": "psnr_p5_over_ticks_db",
    "bound": "bound_mean_over_media_time_db",
    "regret": "regret_mean_over_media_time_db",
}
SURE_TRACES = 6  # with fewer, all on one side are chance more than once in twenty times (sign test)
SHOWN = ("qoe", "stall_ratio", "psnr_mean", "regret")  # figures of which a study has a chart


def study_record(study: Study) -> dict[str, Any]:
    """All tables with the meaning of every figure; what is not known is NaN, and null in JSON."""
    return {
        "package": study.package,
        "answer": study_answer(study),
        "figures": meanings(FIGURES),
        "all": [asdict(summary) for summary in summarise(study)],
        "feasible": [asdict(summary) for summary in summarise(study, True)],
    }


def format_study(study: Study, as_json: bool = False) -> str:
    """The headline figures on all links, and on those whose smallest rungs are feasible."""
    if as_json:
        return to_json(study_record(study))
    everything, feasible = summarise(study), summarise(study, True)
    lines = [conditions(study), "PSNR: dB of a session, mean over display ticks; see the report for all figures", ""]
    lines += [f"all {everything[0].sessions} links:", *_summary_lines(everything), ""]
    if count := feasible[0].sessions:
        words = f"{count} links whose smallest rungs play without a stall from {FEASIBLE_START_S:g} s on:"
        lines += [words, *_summary_lines(feasible), ""]
    return "\n".join(lines[:-1])


def _summary_lines(summaries: Sequence[PolicySummary]) -> list[str]:
    shown = headlines(FIGURES)
    cells = [
        [s.policy, *("-" if np.isnan(s.figures[f.name].mean) else f.text(s.figures[f.name].mean) for f in shown)]
        for s in summaries
    ]
    return table(["policy", *(figure.heading for figure in shown)], cells)


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
    """Whether the quality of the package is known."""
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


def write_study(study: Study, folder: Path) -> Path:
    """Write the page with its pictures, and every figure as CSV and JSON; gives the page.

    index.html, study.json; summary.csv with all figures of the summaries, sessions.csv with every session. Raises
    ConfigError.
    """
    with report_folder(folder):
        _write_csv(folder / "summary.csv", _summary_rows(study))
        _write_csv(folder / "sessions.csv", [_labelled(row) for row in study.rows])
        write_json(folder / "study.json", study_record(study))
        summaries = summarise(study)
        pictures = [
            Picture(f"{f.heading}: {f.meaning}.", partial(_chart, study, summaries, f))
            for f in sorted((f for f in FIGURES if f.name in SHOWN), key=lambda f: SHOWN.index(f.name))
            if not all(math.isnan(s.figures[f.name].mean) for s in summaries)
        ]
        return Page("Policies compared", study_answer(study), pictures, _more(study)).write(folder / "index.html")


def _write_csv(path: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    rows = list(rows)
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def _labelled(row: Row) -> Row:
    return {PSNR_COLUMNS.get(name, name): value for name, value in row.items() if not name.endswith("_percentiles")}


def _summary_rows(study: Study) -> list[Row]:
    """One row for every figure of every policy, in the units of the headings."""
    out: list[Row] = []
    for links, feasible in (("all", None), ("feasible", True)):
        for summary in summarise(study, feasible):
            for figure in FIGURES:
                value, difference = summary.figures[figure.name], summary.differences[figure.name]
                out.append(
                    {"links": links, "sessions": summary.sessions, "policy": summary.policy, "figure": figure.heading}
                    | {name: figure.factor * v for name, v in value._asdict().items()}
                    | {f"difference_{name}": figure.factor * v for name, v in difference._asdict().items()}
                    | {"meaning": figure.meaning}
                )
    return out


def _more(study: Study) -> dict[str, str]:
    """All tables as HTML, and what they are of."""
    shown = headlines(FIGURES)
    smallest = f"Links whose smallest rungs play without a stall from {FEASIBLE_START_S:g} s on"
    more = {}
    for title, wanted in (("All links", None), (smallest, True)):
        summaries = summarise(study, wanted)
        if not summaries[0].sessions:
            continue
        more[f"{title}: {summaries[0].sessions}"] = _interval_table((s.policy, s.figures) for s in summaries)
        if len(summaries) > 1:
            words = f"{title}: differences to {summaries[0].policy} (paired)"
            more[words] = _interval_table((s.policy, s.differences) for s in summaries[1:])
    said = [("what was played", conditions(study)), *((f.heading, f.meaning) for f in shown)]
    words = "Below each mean its 95 % interval, bootstrapped over traces."
    files = " and ".join(f'<a href="{name}">{name}</a>' for name in ("summary.csv", "sessions.csv"))
    return more | {"What the figures are": f"<p>{words} {files} have all others.</p>{html_table(said)}"}


def _interval_table(rows: Iterable[tuple[str, Mapping[str, Interval]]]) -> str:
    """The headline figures, each with its interval below it."""
    shown = headlines(FIGURES)
    cells = ((policy, *(_interval_cell(f, values[f.name]) for f in shown)) for policy, values in rows)
    return html_table(cells, ["", *(figure.heading for figure in shown)])


def _interval_cell(figure: Figure, value: Interval) -> str:
    if math.isnan(value.mean):
        return "-"
    mean, low, high = (figure.text(v) for v in value)
    return f"{mean}\n{low} to {high}"


def _chart(study: Study, summaries: Sequence[PolicySummary], figure: Figure, axis: Any) -> None:
    """A row for each policy: its mean with the interval, and every session as a small mark."""
    for row, summary in enumerate(summaries):
        mean, low, high = figure.factor * np.array(summary.figures[figure.name])
        sessions = figure.factor * study.of(summary.policy, figure.name)
        axis.plot(sessions, np.full(len(sessions), row), "|", color=GREY, alpha=0.6)
        axis.plot([low, high], [row, row], color=BLUE, linewidth=2)
        axis.plot(mean, row, "o", color=ORANGE if summary.policy in ORACLES else BLUE, ms=5)
    axis.set_yticks(range(len(summaries)), [s.policy for s in summaries], fontsize=8)
    axis.set(xlabel=figure.heading, ylim=(len(summaries) - 0.5, -0.5))

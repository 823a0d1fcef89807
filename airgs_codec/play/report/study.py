"""A study as text, as CSV and as JSON."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec._report import require_matplotlib, table
from airgs_codec.errors import ConfigError
from airgs_codec.places.whole import to_json, write_json
from airgs_codec.play.figures import FIGURES, headlines, meanings
from airgs_codec.play.report.study_page import plot_study, study_page
from airgs_codec.play.study import FEASIBLE_START_S, PolicySummary, Row, Study, summarise

PSNR_COLUMNS = {  # headings of the table of single sessions: which PSNR it is
    "psnr_mean": "psnr_mean_over_ticks_db",
    "psnr_p5": "psnr_p5_over_ticks_db",
    "bound": "bound_mean_over_media_time_db",
    "regret": "regret_mean_over_media_time_db",
}


def study_record(study: Study) -> dict[str, Any]:
    """All tables with the meaning of every figure; what is not known is NaN, and null in JSON."""
    return {
        "package": study.package,
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
    """What was played over what, in a sentence."""
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


def write_study(study: Study, folder: Path) -> Path:
    """Write the page with its picture, and every figure as CSV and JSON; gives the page.

    index.html, study.png, study.json; summary.csv with all figures of the summaries, sessions.csv with every session.
    Raises ConfigError.
    """
    require_matplotlib("the study's page")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _write_csv(folder / "summary.csv", _summary_rows(study))
        _write_csv(folder / "sessions.csv", [_labelled(row) for row in study.rows])
        write_json(folder / "study.json", study_record(study))
        plot_study(study, folder / "study.png")
        (folder / "index.html").write_text(study_page(study, conditions(study)), encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{folder}: cannot write the study: {error}") from error
    return folder / "index.html"


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

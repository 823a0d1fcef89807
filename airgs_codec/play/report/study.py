"""A study as text, as CSV and JSON, and as a page: the headline figures, and pictures of their distributions."""

from __future__ import annotations

import csv
import html
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec._report import new_figure, page, plain_log_ticks, require_matplotlib, save_figure, table
from airgs_codec.errors import ConfigError
from airgs_codec.places.whole import to_json, write_json
from airgs_codec.play.metrics import FIGURES, Figure, headlines, meanings
from airgs_codec.play.study import FEASIBLE_START_S, Interval, PolicySummary, Row, Study, summarise

PSNR_COLUMNS = {  # headings of the table of single sessions: which PSNR it is
    "psnr_mean": "psnr_mean_over_ticks_db",
    "psnr_p5": "psnr_p5_over_ticks_db",
    "bound": "bound_mean_over_media_time_db",
    "regret": "regret_mean_over_media_time_db",
}
STYLE = (
    "table{border-collapse:collapse;font-size:14px}td,th{padding:.25rem .8rem;text-align:right}"
    "th:first-child{text-align:left}tr:nth-child(even){background:#f4f4f6}"
    "small{color:#777;display:block;white-space:nowrap}"
    "dl{display:grid;grid-template-columns:max-content 1fr;gap:.1rem 1rem;font-size:13px}dd{margin:0}"
)


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


def study_page(study: Study, conditions: str) -> str:
    """The page as HTML; study.png and the CSV files lie beside it."""
    parts = [f"<p>{html.escape(conditions)}</p>"]
    smallest = f"Links whose smallest rungs play without a stall from {FEASIBLE_START_S:g} s on"
    for title, wanted in (("All links", None), (smallest, True)):
        summaries = summarise(study, wanted)
        if not summaries[0].sessions:
            continue
        parts += [f"<h2>{title}: {summaries[0].sessions}</h2>"]
        parts += [_interval_table((s.policy, s.figures) for s in summaries)]
        if len(summaries) > 1:
            words = f"The same links, differences to {summaries[0].policy} (paired)"
            parts += [f"<h3>{html.escape(words)}</h3>"]
            parts += [_interval_table((s.policy, s.differences) for s in summaries[1:])]
    parts += ["<p>Below each mean its 95 % interval, bootstrapped over traces. ", _link("summary.csv")]
    parts += [" has these and all other figures, ", _link("sessions.csv"), " every session.</p>"]
    parts += [_definitions(headlines(FIGURES))]
    parts += ['<img src="study.png" alt="quality against stalls, and distributions over sessions">']
    return page("Policies compared", "".join(parts), "1100px", STYLE)


def _link(name: str) -> str:
    return f'<a href="{name}">{name}</a>'


def _definitions(figures: Sequence[Figure]) -> str:
    items = (f"<dt>{html.escape(f.heading)}</dt><dd>{html.escape(f.meaning)}</dd>" for f in figures)
    return f"<dl>{''.join(items)}</dl>"


def _interval_table(rows: Iterable[tuple[str, Mapping[str, Interval]]]) -> str:
    """The headline figures, each with its interval below it."""
    shown = headlines(FIGURES)
    head = "".join(f"<th>{figure.heading}</th>" for figure in shown)
    body = ""
    for policy, values in rows:
        cells = "".join(f"<td>{_interval_cell(figure, values[figure.name])}</td>" for figure in shown)
        body += f"<tr><th>{html.escape(policy)}</th>{cells}</tr>"
    return f"<table><tr><th></th>{head}</tr>{body}</table>"


def _interval_cell(figure: Figure, value: Interval) -> str:
    if math.isnan(value.mean):
        return "-"
    mean, low, high = (figure.text(v) for v in value)
    return f"{mean}<small>{low} to {high}</small>"


def plot_study(study: Study, path: Path) -> None:
    """Quality against stalls, and distributions over sessions: quality, stalls, regret, time on the way.

    Raises ConfigError.
    """
    figure = new_figure(13, 9)
    axes = figure.subplots(2, 3)
    means, (quality, worst), (stalls, regret, transmission) = axes[0, 0], axes[0, 1:], axes[1]
    for i, summary in enumerate(summarise(study)):
        policy, color = summary.policy, f"C{i}"
        _mean_point(means, summary.figures, color, policy)
        _distribution(quality, study.of(policy, "psnr_mean"), color)
        _distribution(worst, study.of(policy, "psnr_p5"), color)
        _distribution(stalls, 100 * study.of(policy, "stall_ratio"), color)
        _distribution(regret, study.of(policy, "regret"), color)
        times = [t for r in study.rows if r["policy"] == policy for t in r["frame_ms_percentiles"]]
        _distribution(transmission, np.array(times), color)
    means.set(xlabel="time waited, %", ylabel="PSNR dB, mean over ticks", title="Means with 95 % intervals")
    quality.set(xlabel="PSNR dB, mean over ticks", ylabel="share of sessions", title="Quality of sessions")
    worst.set(xlabel="PSNR dB, 5th percentile over ticks", ylabel="share of sessions", title="Worst moments")
    stalls.set(xlabel="time waited, %", ylabel="share of sessions", title="Stalls of sessions")
    _stall_scale(stalls)
    regret.set(xlabel="dB under the best possible", ylabel="share of sessions", title="Regret of sessions")
    transmission.set(xlabel="ms on the way (dashed: a frame on the screen)", ylabel="share of frames")
    transmission.set_title("Transmission of frames")
    transmission.set_xscale("log")
    plain_log_ticks(transmission.xaxis)
    transmission.axvline(1e3 * study.rows[0]["played_s"] / study.rows[0]["frames"], color="0.5", linestyle="--")
    for axis in axes.ravel():
        axis.grid(alpha=0.25)
    columns = min(6, len(study.settings.policies))
    figure.legend(*means.get_legend_handles_labels(), loc="outside lower center", ncols=columns)
    save_figure(figure, path)


def _mean_point(axis: Any, figures: Mapping[str, Interval], color: str, name: str) -> None:
    """A point with its two intervals."""
    (x, x_low, x_high), (y, y_low, y_high) = (100 * np.array(figures["stall_ratio"]), figures["psnr_mean"])
    spread = {"xerr": [[x - x_low], [x_high - x]], "yerr": [[y - y_low], [y_high - y]]}
    axis.errorbar(x, y, **spread, fmt="o", color=color, label=name)


def _stall_scale(axis: Any) -> None:
    """A logarithmic axis of percent that has a zero."""
    axis.set_xscale("symlog", linthresh=0.1)
    axis.set_xlim(0, 100)
    axis.set_xticks([0, 0.1, 1, 10, 100], ["0", "0.1", "1", "10", "100"])
    axis.minorticks_off()


def _distribution(axis: Any, values: NDArray[np.float64], color: str) -> None:
    """The share of values up to each of them."""
    known = np.sort(values[np.isfinite(values)])
    if len(known):
        axis.step(known, np.arange(1, len(known) + 1) / len(known), where="post", color=color)

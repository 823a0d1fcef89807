"""The page of a study: the headline figures, and pictures of their distributions over sessions."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec._report import new_figure, page, plain_log_ticks, save_figure
from airgs_codec.play.figures import FIGURES, Figure, headlines
from airgs_codec.play.study import FEASIBLE_START_S, Interval, Study, summarise

STYLE = (
    "table{border-collapse:collapse;font-size:14px}td,th{padding:.25rem .8rem;text-align:right}"
    "th:first-child{text-align:left}tr:nth-child(even){background:#f4f4f6}"
    "small{color:#777;display:block;white-space:nowrap}"
    "dl{display:grid;grid-template-columns:max-content 1fr;gap:.1rem 1rem;font-size:13px}dd{margin:0}"
)


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

"""A study as text, and as a page with pictures."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec._files import to_json
from airgs_codec._report import new_figure, page, save_figure, table
from airgs_codec.errors import ConfigError
from airgs_codec.play.study import FEASIBLE_START_S, Row, Study, frame_summary, study_record, summarise, write_rows

COLUMNS = (  # figure, heading, factor, digits
    ("psnr_mean", "PSNR dB", 1, 2),
    ("psnr_p5", "5th %ile", 1, 2),
    ("stall_ratio", "stalled %", 100, 2),
    ("startup_s", "start s", 1, 2),
    ("switches", "switches", 1, 1),
    ("change_db", "change dB", 1, 2),
    ("bytes_per_frame", "kB/frame", 1e-3, 2),
    ("wasted", "wasted %", 100, 1),
    ("utilisation", "used %", 100, 0),
    ("infeasible", "no fit %", 100, 1),
    ("regret", "regret dB", 1, 2),
    ("qoe", "QoE", 1, 2),
    ("frame_ms_p95", "95 % ms", 1, 0),
)
MORE_COLUMNS = (  # on the page alone
    ("frame_ms_p50", "median ms", 1, 0),
    ("frame_ms_max", "worst ms", 1, 0),
    ("late", "late %", 100, 1),
    ("key_kb_frame", "key kB", 1, 2),
    ("state_kb_frame", "state kB", 1, 2),
    ("sidecars_kb_frame", "sidecars kB", 1, 2),
    ("init_kb_frame", "init kB", 1, 2),
    ("manifests_kb_frame", "manifests kB", 1, 2),
)
FRAME_COLUMNS = (
    ("kb_frame", "kB/frame", 1, 2),
    ("psnr", "PSNR dB", 1, 2),
    ("paper_mean_ms", "mean ms", 1, 1),
    ("paper_p95_ms", "95 % ms", 1, 1),
    ("paper_max_ms", "worst ms", 1, 1),
    ("paper_max_ms_share", "of unpruned", 1, 2),
    ("link_mean_ms", "link mean", 1, 1),
    ("link_p95_ms", "link 95 %", 1, 1),
    ("link_max_ms", "link worst", 1, 0),
    ("late", "late %", 100, 1),
    ("infeasible", "no fit %", 100, 1),
    ("skipped", "skipped %", 100, 1),
)


def format_study(study: Study, as_json: bool = False) -> str:
    """Both tables, all links and those whose smallest rungs are feasible, and frame mode."""
    if as_json:
        return to_json(study_record(study))
    s = study.settings
    rows = [r for r in study.rows if r["policy"] == s.policies[0]]
    feasible = sum(r["feasible"] for r in rows)
    lines = [_conditions(study), ""]
    for title, wanted in (
        (f"all {len(rows)} links", None),
        (f"{feasible} links whose smallest rungs play without a stall from {FEASIBLE_START_S:g} s on", True),
    ):
        if wanted is None or feasible:
            cells = [
                [r["policy"], *(_cell(r[name], f, d) for name, _, f, d in COLUMNS)] for r in summarise(study, wanted)
            ]
            lines += [f"{title}:", *table(["policy", *(h for _, h, _, _ in COLUMNS)], cells), ""]
    lines += ["the paper's frame mode, state only (see --mode frames):"]
    return "\n".join(lines + frame_lines(study.frame_rows))


def frame_lines(frame_rows: Sequence[Row]) -> list[str]:
    """The table of frame mode: ms by the rate of the moment, then over the link one frame after another."""
    rows = frame_summary(frame_rows)
    cells = [[r["chooser"], *(f"{f * r[name]:.{d}f}" for name, _, f, d in FRAME_COLUMNS)] for r in rows]
    return table(["choice", *(h for _, h, _, _ in FRAME_COLUMNS)], cells)


def _conditions(study: Study) -> str:
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


def _cell(value: tuple[float, float, float], factor: float, digits: int) -> str:
    return "-" if math.isnan(value[0]) else f"{factor * value[0]:.{digits}f}"


def write_study(study: Study, folder: Path) -> Path:
    """sessions.csv, frames.csv, study.json, study.png and index.html; gives the page. Raises ConfigError."""
    write_rows(study, folder)
    try:
        plot_study(study, folder / "study.png")
        (folder / "index.html").write_text(_page(study), encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{folder}: cannot write the study: {error}") from error
    return folder / "index.html"


def plot_study(study: Study, path: Path) -> None:
    """Quality against stalls, and distributions over sessions: regret, stalls, time on the way, quality."""
    figure = new_figure(13, 8.5)
    axes = figure.subplots(2, 3)
    policies = study.settings.policies
    for i, (row, policy) in enumerate(zip(summarise(study), policies, strict=True)):
        color = f"C{i}"
        x, y = [tuple(f * v for v in row[name]) for name, f in (("stall_ratio", 100), ("psnr_mean", 1))]
        axes[0, 0].errorbar(
            x[0], y[0], [[y[0] - y[1]], [y[2] - y[0]]], [[x[0] - x[1]], [x[2] - x[0]]], "o", color=color, label=policy
        )
        _distribution(axes[0, 1], study.of(policy, "psnr_mean"), color, policy)
        _distribution(axes[0, 2], study.of(policy, "psnr_p5"), color, policy)
        _distribution(axes[1, 0], 100 * study.of(policy, "stall_ratio"), color, policy)
        _distribution(axes[1, 1], study.of(policy, "regret"), color, policy)
        times = [t for r in study.rows if r["policy"] == policy for t in r["frame_ms_percentiles"]]
        _distribution(axes[1, 2], np.array(times), color, policy)
    axes[0, 0].set(xlabel="time waited, %", ylabel="PSNR on screen, dB", title="Means with 95 % intervals")
    axes[0, 1].set(xlabel="mean PSNR on screen, dB", ylabel="share of sessions", title="Quality of sessions")
    axes[0, 2].set(xlabel="5th percentile of PSNR, dB", ylabel="share of sessions", title="Worst moments of sessions")
    axes[1, 0].set(xlabel="time waited, %", ylabel="share of sessions", title="Stalls of sessions")
    axes[1, 0].set_xscale("symlog", linthresh=0.1)
    axes[1, 0].set_xlim(left=0)
    axes[1, 1].set(xlabel="dB under the best possible", ylabel="share of sessions", title="Regret of sessions")
    axes[1, 2].set(xlabel="ms a frame was on its way", ylabel="share of frames", title="Transmission of frames")
    axes[1, 2].set_xscale("log")
    axes[1, 2].axvline(1e3 * study.rows[0]["played_s"] / study.rows[0]["frames"], color="0.5", linestyle="--")
    for axis in axes.ravel():
        axis.grid(alpha=0.25)
    axes[0, 0].legend(fontsize=8)
    save_figure(figure, path)


def _distribution(axis: Any, values: np.ndarray, color: str, name: str) -> None:
    known = np.sort(values[np.isfinite(values)])
    if len(known):
        axis.step(known, np.arange(1, len(known) + 1) / len(known), where="post", color=color, label=name)


def _page(study: Study) -> str:
    parts = [f"<p>{html.escape(_conditions(study))}</p>"]
    for title, wanted in (("All links", None), ("Links whose smallest rungs are feasible", True)):
        rows = summarise(study, wanted)
        if rows[0]["sessions"]:
            parts += [f"<h2>{title}: {rows[0]['sessions']}</h2>", _table(rows, "")]
            if len(rows) > 1:
                words = f"The same links, differences to {rows[0]['policy']} (paired)"
                parts += [f"<h3>{html.escape(words)}</h3>", _table(rows[1:], "_difference")]
    parts.append('<img src="study.png" alt="quality against stalls, and distributions over sessions">')
    head = "".join(f"<th>{h}</th>" for _, h, _, _ in FRAME_COLUMNS)
    body = "".join(
        f"<tr><th>{r['chooser']}</th>"
        + "".join(f"<td>{f * r[name]:.{d}f}</td>" for name, _, f, d in FRAME_COLUMNS)
        + "</tr>"
        for r in frame_summary(study.frame_rows)
    )
    parts += [
        "<h2>The paper's frame mode</h2><p>State only; a frame is pushed at t / R with the true rate of that moment as "
        "B. Milliseconds are bits over that rate (outages left out), then over the link one frame after another. "
        "“of unpruned”: the worst frame of a run over that of the unpruned stream, median over runs.</p>",
        f"<table><tr><th></th>{head}</tr>{body}</table>",
    ]
    style = (
        "table{border-collapse:collapse;font-size:13px}td,th{padding:.2rem .6rem;text-align:right}"
        "th:first-child{text-align:left}tr:nth-child(even){background:#f4f4f6}small{color:#777;display:block}"
    )
    return page("Policies compared", "".join(parts), "1700px", style)


def _table(rows: list[Row], suffix: str) -> str:
    head = "".join(f"<th>{h}</th>" for _, h, _, _ in (*COLUMNS, *MORE_COLUMNS))
    body = ""
    for row in rows:
        cells = ""
        for name, _, factor, digits in (*COLUMNS, *MORE_COLUMNS):
            mean, low, high = (factor * v for v in row[name + suffix])
            words = (
                "-" if math.isnan(mean) else f"{mean:.{digits}f}<small>{low:.{digits}f} to {high:.{digits}f}</small>"
            )
            cells += f"<td>{words}</td>"
        body += f"<tr><th>{html.escape(row['policy'])}</th>{cells}</tr>"
    return f"<table><tr><th></th>{head}</tr>{body}</table>"

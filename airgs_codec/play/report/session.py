"""What a session was like: its figures as text, and a page with an answer and pictures."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec._report import BLUE, GREEN, GREY, RED, Page, Picture, html_table, report_folder
from airgs_codec.media.image import write_png
from airgs_codec.package.region import RegionSummary
from airgs_codec.places.whole import write_json
from airgs_codec.play.fetcher import SHORTEST_S
from airgs_codec.play.metrics import FIGURES, SessionMetrics, meanings
from airgs_codec.play.report.answer import answer, rung_record
from airgs_codec.play.report.map import Viewer, draw_walk
from airgs_codec.play.session import SessionLog, session_bound

MOST_LINES = 10  # of what went wrong
LEAST_DB = 2.0  # of an axis: less is not seen


def write_report(
    log: SessionLog, directory: Path, viewer: Viewer | None = None, screen: NDArray[np.uint8] | None = None
) -> Path:
    """Write index.html with its pictures, and session.json, into `directory`; gives the page.

    `screen`: (H, 2 W, 3) what was seen, beside the best rung. Raises ConfigError.
    """
    with report_folder(directory):
        record = {
            "metrics": log.metrics.as_dict(),
            "answer": answer(log, viewer),
            **place_record(log, viewer),
            "rungs": rung_record(log),
            "meanings": meanings(FIGURES),
            "fetches": [dataclasses.asdict(f) for f in log.fetches],
            "shown": [dataclasses.asdict(s) for s in log.shown],
        }
        write_json(directory / "session.json", record)
        if screen is not None:
            write_png(directory / "screen.png", screen)
        page = Page(
            f"A session of {log.policy}", answer(log, viewer), _pictures(log, viewer, screen), _more(log, viewer)
        )
        return page.write(directory / "index.html")


def place_record(log: SessionLog, viewer: Viewer | None) -> dict[str, Any]:
    """The viewing region, and how the viewer stayed in it (None: there was no walk), as plain values."""
    region = dataclasses.asdict(RegionSummary.of(log.offers.manifest.region))
    return {"region": region, "viewer": viewer.table() if viewer else None}


def _pictures(log: SessionLog, viewer: Viewer | None, screen: NDArray[np.uint8] | None) -> list[Picture]:
    """What was seen, the link, the quality; and a walk that left the region."""
    rates = "The link and what was asked of it; red: the viewer waits."
    shown = "PSNR on the screen over time; red: the viewer waits."
    pictures = [Picture(rates, partial(_rates, log)), Picture(shown, partial(_psnr, log))]
    if screen is not None:
        words = "The worst segment that was shown: at the package's best rung, and as it was seen."
        pictures.insert(0, Picture(words, name="screen.png", panels=2, shape=screen.shape))
    if viewer is not None and viewer.outside:
        words = "The viewing region from above, in world units; red: where the walk left it."
        pictures.append(Picture(words, partial(draw_walk, viewer)))
    return pictures


def _over_time(axis: Any, log: SessionLog, name: str) -> None:
    """Seconds along a chart, with the waits in red."""
    for s in log.shown:
        if s.stall_s > SHORTEST_S:
            axis.axvspan(s.start_s - s.stall_s, s.start_s, color=RED, alpha=0.2, linewidth=0)
    axis.set(xlabel="seconds since the first request", ylabel=name, xlim=(0, _end(log)))


def _end(log: SessionLog) -> float:
    last = log.shown[-1]
    return last.start_s + last.frames / log.offers.fps


def _rates(log: SessionLog, axis: Any) -> None:
    if log.link is not None:
        grid = np.linspace(0, _end(log), 1500)
        rates = [log.link.trace.rate_at(t) / 1e6 for t in grid]
        axis.fill_between(grid, rates, color=BLUE, alpha=0.25, linewidth=0, label="link")
    axis.step(
        [f.request_s for f in log.fetches], [f.throughput_bps / 1e6 for f in log.fetches], where="post", color=BLUE
    )
    axis.lines[-1].set_label("expected")
    rungs = rung_record(log)
    times_s = [s.start_s for s in log.shown if s.rung is not None]
    shown = [rungs[s.rung]["mbps"] for s in log.shown if s.rung is not None]
    axis.step(times_s, shown, where="post", color=GREEN, label="shown")
    axis.axhline(min(rung["mbps"] for rung in rungs), color=GREY, linestyle="--", label="lowest rung")
    _over_time(axis, log, "Mbit/s")
    axis.set_ylim(0, 1.3 * axis.get_ylim()[1])  # room for the legend
    axis.legend(ncols=4, loc="upper center", fontsize=8, handlelength=1, columnspacing=1, frameon=False)


def _psnr(log: SessionLog, axis: Any) -> None:
    values = [log.shown[i].psnr for i, _ in log.screen_ticks]
    if all(v is None for v in values):
        axis.text(0.5, 0.5, "quality was not measured", ha="center", transform=axis.transAxes)
    else:
        at_s = log.shown[0].start_s + np.arange(len(values)) / log.offers.fps
        axis.step(at_s, np.array(values, np.float64), where="post", color=BLUE)
        low, high = axis.get_ylim()
        axis.set_ylim(min(low, high - LEAST_DB), high)
    _over_time(axis, log, "dB")


def format_metrics(log: SessionLog, viewer: Viewer | None = None) -> str:
    """The figures as lines of text."""
    return "\n".join(f"{name:<22}{value}" for name, value in [*_readable(log), *_place_rows(log, viewer)])


def _place_rows(log: SessionLog, viewer: Viewer | None) -> list[tuple[str, str]]:
    region = RegionSummary.of(log.offers.manifest.region)
    rows = [("viewing region", region.words), ("views", region.views)]
    return rows + ([("viewer", viewer.words)] if viewer else [])


def _readable(log: SessionLog) -> list[tuple[str, str]]:
    r: dict[str, Any] = log.metrics.as_dict()
    bound = session_bound(log) if log.offers.manifest.measured else None
    quality = "not measured"
    if r["psnr_mean"] is not None:
        quality = f"mean over ticks {r['psnr_mean']:.2f} dB, 5th percentile {r['psnr_p5']:.2f} dB"
    wire = ", ".join(f"{kind} {size / 1e3:.1f}" for kind, size in r["bytes"].items())
    used = "" if r["utilisation"] is None else f", {100 * r['utilisation']:.0f} % of what could pass"
    rows = [
        ("policy", log.policy),
        ("trace", _trace_words(log.metrics)),
        ("played", f"{r['frames']} frames, {r['played_s']:.2f} s"),
        ("start-up", _startup_words(log.metrics)),
        ("stalls", f"{r['stalls']}, {r['stall_s']:.3f} s, {100 * r['stall_ratio']:.2f} %"),
        ("PSNR on screen", quality),
        ("rungs", ", ".join(f"{name} x{count}" for name, count in r["rungs"].items())),
        ("Gaussians", _gaussian_words(log)),
        ("switches", f"{r['switches']}, mean change {r['change_db']:.2f} dB"),
        ("fetched, kB", f"{wire}; {r['bytes_per_frame'] / 1e3:.2f} a frame"),
        ("wire", f"{r['wire_bytes'] / 1e3:.1f} kB with headers" + used),
        ("wasted", f"{100 * r['wasted']:.1f} %: {r['replaced']} replacements, {r['abandoned']} abandoned"),
        ("frame on its way", f"mean {r['frame_ms_mean']:.0f} ms, 95 % under {r['frame_ms_p95']:.0f} ms"),
        ("no rung fitted", f"{100 * r['infeasible']:.0f} %"),
    ]
    if r["delta_e_mean"] is not None:
        rows.append(("ΔE on screen", f"mean {r['delta_e_mean']:.2f} (CIEDE2000; about 1 is just noticeable)"))
    if r["qoe"] is not None:
        rows.append(("QoE", f"{r['qoe']:.2f} dB: quality - changes - 20 dB for a second of waiting"))
    if bound is not None:
        regret = f"regret {bound - log.mean_quality:.2f} dB"
        rows.append(("best possible", f"at most {bound:.2f} dB at the same moments, mean of segments: {regret}"))
    if log.lost:
        rows.append(("lost", f"{r['lost_frames']} frames; {some(log.lost)}"))
    if log.retried:
        rows.append(("asked for again", f"{len(log.retried)} files; {some(log.retried)}"))
    return rows


def _gaussian_words(log: SessionLog) -> str:
    budget = log.settings.budget
    return f"at most {log.metrics.gaussians:,}" + ("" if budget is None else f" of a budget of {budget:,}")


def some(lines: Sequence[str]) -> str:
    """The first of some lines, and how many more there are."""
    more = len(lines) - MOST_LINES
    return "; ".join(lines[:MOST_LINES]) + (f"; and {more} more" if more > 0 else "")


def _trace_words(m: SessionMetrics) -> str:
    if m.trace is None or m.trace_mean_bps is None:
        return "none: a real connection"
    notes = [f"from {m.trace_offset_s:g} s"] * bool(m.trace_offset_s)
    notes += [f"rates x{m.trace_scale:g}"] * (m.trace_scale != 1)
    notes += [{"loop": "repeated", "hold": "last rate held", "error": ""}[m.trace_end or "loop"]] * bool(m.trace_ended)
    return ", ".join([f"{m.trace}, mean {m.trace_mean_bps / 1e6:.2f} Mbit/s", *notes])


def _startup_words(m: SessionMetrics) -> str:
    tables = f"{m.startup_table_bytes / 1e3:.1f} of them tables"
    return f"{m.startup_s:.3f} s: {m.startup_requests} requests, {m.startup_bytes / 1e3:.1f} kB, {tables}"


def _more(log: SessionLog, viewer: Viewer | None) -> dict[str, str]:
    """All figures, and what the package says of its rungs, as HTML."""
    rungs = [
        (
            r["rung"],
            *("-" if r[name] is None else f"{r[name]:.2f} dB" for name in ("psnr", "worst")),
            f"{r['mbps']:.2f}",
            str(r["shown"]),
            "-" if r["psnr"] is None else "yes" if r["on_ladder"] else "no",
        )
        for r in rung_record(log)
    ]
    head = ("rung, best first", "PSNR", "worst picture", "Mbit/s", "segments shown", "worth its bytes")
    return {
        "All figures": html_table([*_readable(log), *_place_rows(log, viewer)]),
        "What the package claims of its rungs": html_table(rungs, head),
    }

"""Pictures and a page of what happened in a session."""

from __future__ import annotations

import dataclasses
import html
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec._report import new_figure, page, plain_log_ticks, save_figure
from airgs_codec.errors import ConfigError
from airgs_codec.package.manifest import pooled_quality
from airgs_codec.package.region import RegionSummary
from airgs_codec.places.whole import write_json
from airgs_codec.play.downloader import BatchKind
from airgs_codec.play.metrics import FIGURES, SessionMetrics, meanings
from airgs_codec.play.playout import TileFigures
from airgs_codec.play.report.map import Viewer, plot_region
from airgs_codec.play.session import SessionLog, session_bound

MOST_LINES = 10  # of what went wrong
_BLUE, _ORANGE, _GREEN, _RED, _GREY = "#2a6fbb", "#e08a1e", "#3a9a5b", "#c8453b", "#8a8f98"


def write_report(log: SessionLog, directory: Path, viewer: Viewer | None = None) -> Path:
    """Write session.json, session.png and index.html into `directory`, and region.png where the viewer's walk is known;
    gives the page.

    Raises ConfigError.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        record = {
            "metrics": log.metrics.as_dict(),
            **place_record(log, viewer),
            "rungs": _rung_record(log),
            "meanings": meanings(FIGURES),
            "fetches": [dataclasses.asdict(f) for f in log.fetches],
            "shown": [dataclasses.asdict(s) for s in log.shown],
        }
        write_json(directory / "session.json", record)
        plot_session(log, directory / "session.png")
        if viewer is not None:
            plot_region(viewer, directory / "region.png")
        (directory / "index.html").write_text(_page(log, directory, viewer), encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{directory}: cannot write the report: {error}") from error
    return directory / "index.html"


def place_record(log: SessionLog, viewer: Viewer | None) -> dict[str, Any]:
    """The viewing region, and how the viewer stayed in it (None: there was no walk), as plain values."""
    region = dataclasses.asdict(RegionSummary.of(log.offers.manifest.region))
    return {"region": region, "viewer": viewer.table() if viewer else None}


def _rung_record(log: SessionLog) -> list[dict[str, Any]]:
    """Every rung with the quality that the package claims for it, None where it was not measured."""
    c = log.offers
    qualities = [pooled_quality(c.manifest, level, quality) for quality, level in c.rungs]
    return [
        {"rung": name, "psnr": q.psnr if q else None, "worst": q.worst if q else None}
        for name, q in zip(c.names, qualities, strict=True)
    ]


def plot_session(log: SessionLog, path: Path) -> None:
    """Panels over time: throughput, rungs, buffer, PSNR on the screen, arrival of every frame, time it took, and the
    tiles where they were fetched by view.
    """
    panels = [_throughput, _rungs, _buffer, _psnr, _arrivals, _transfers, *([plot_tiles] if log.tiles else [])]
    figure = new_figure(11, 2.75 * len(panels))
    axes = figure.subplots(len(panels), 1, sharex=True)
    for draw, axis in zip(panels, axes, strict=True):
        draw(axis, log)
        axis.grid(alpha=0.25)
        for s in log.shown:
            if s.stall_s > 1e-9:
                axis.axvspan(s.start_s - s.stall_s, s.start_s, color=_RED, alpha=0.12, linewidth=0)
    axes[-1].set_xlabel("seconds since the first request (red: waiting for data)")
    axes[0].set_xlim(0, _end(log))
    save_figure(figure, path)


def _end(log: SessionLog) -> float:
    last = log.shown[-1]
    return last.start_s + last.frames / log.offers.fps


def _throughput(axis: Any, log: SessionLog) -> None:
    title = "Throughput of a real connection"
    if log.link is not None:
        trace, grid = log.link.trace, np.linspace(0, _end(log), 1500)
        rates = [trace.rate_at(t) / 1e6 for t in grid]
        axis.fill_between(grid, rates, color=_BLUE, alpha=0.25, linewidth=0, label="trace")
        title = f"Throughput: {trace.name}, mean {trace.mean_bps / 1e6:.1f} Mbit/s"
    times = [f.request_s for f in log.fetches]
    axis.step(times, [f.throughput_bps / 1e6 for f in log.fetches], where="post", color=_BLUE, label="estimate")
    axis.set(ylabel="Mbit/s", title=title, ylim=(0, None))
    sizes = axis.twinx()
    for kind, marker, color in (
        (BatchKind.GROUP, "s", _ORANGE),
        (BatchKind.STATE, "o", _GREEN),
        (BatchKind.REPLACEMENT, "^", _RED),
        (BatchKind.REPAIR, "v", _RED),
    ):
        batch = [f for f in log.fetches if f.kind is kind]
        if not batch:
            continue
        sizes.plot(
            [f.request_s for f in batch],
            [f.bytes / 1e3 for f in batch],
            marker,
            color=color,
            ms=4,
            label="key + state" if kind is BatchKind.GROUP else kind,
        )
    budgets = [(f.request_s, f.budget_bytes / 1e3) for f in log.fetches if f.budget_bytes > 0]
    if budgets:
        sizes.plot(*zip(*budgets, strict=True), "_", color=_GREY, ms=8, label="budget")
    sizes.set(ylabel="kB a batch", yscale="log")
    sizes.tick_params(labelsize=8)
    axis.set_ylim(0, 1.2 * axis.get_ylim()[1])  # room for the legend
    sizes.set_ylim(top=2 * sizes.get_ylim()[1])
    plain_log_ticks(sizes.yaxis)
    lines = [*axis.get_legend_handles_labels()[0], *sizes.get_legend_handles_labels()[0]]
    axis.legend(lines, [line.get_label() for line in lines], loc="upper right", ncols=5, fontsize=8)


def _rungs(axis: Any, log: SessionLog) -> None:
    names = [*log.offers.names, "lost"]
    for s in log.shown:
        y = len(names) - 1 if s.rung is None else s.rung
        color = _GREEN if s.rung is not None else _RED
        axis.plot([s.start_s, s.start_s + s.frames / log.offers.fps], [y, y], color=color, linewidth=5)
    if all(s.rung is not None for s in log.shown):
        names.pop()
    axis.set_yticks(range(len(names)), names, fontsize=8)
    axis.set(title="Rung shown: key quality and level", ylim=(len(names) - 0.5, -0.5))


def _buffer(axis: Any, log: SessionLog) -> None:
    fps = log.offers.fps
    ready = [0.0, *np.cumsum([s.frames / fps for s in log.shown])]
    grid = np.linspace(0, _end(log), 1500)
    starts, arrivals = np.array([s.start_s for s in log.shown]), np.array([s.ready_s for s in log.shown])
    lengths = np.array([s.frames / fps for s in log.shown])
    played = np.array([np.clip(t - starts, 0, lengths).sum() for t in grid])
    at_hand = np.array(ready)[np.searchsorted(arrivals, grid, side="right")]
    axis.fill_between(grid, at_hand - played, color=_ORANGE, alpha=0.5, linewidth=0)
    result = log.metrics
    title = f"Buffer: {result.stalls} stalls, {result.stall_s:.2f} s of waiting after the start"
    axis.set(ylabel="s of media", title=title, ylim=(0, None))


def _psnr(axis: Any, log: SessionLog) -> None:
    values = [log.shown[i].psnr for i, _ in log.screen_ticks]
    if all(v is None for v in values):
        axis.text(0.5, 0.5, "quality was not measured", ha="center", transform=axis.transAxes)
    else:
        fps = log.offers.fps
        times = log.shown[0].start_s + np.arange(len(values)) / fps
        axis.step(times, np.array(values, np.float64), where="post", color=_BLUE)
    axis.set(ylabel="dB", title="PSNR on the screen: each segment has that of its rung, a frozen picture keeps its own")


def _arrivals(axis: Any, log: SessionLog) -> None:
    fps = log.offers.fps
    displays = np.concatenate([s.start_s + np.arange(s.frames) / fps for s in log.shown])
    arrivals = np.concatenate([np.full(s.frames, s.ready_s) for s in log.shown])
    frames = np.arange(len(displays))
    axis.step(displays, frames, where="post", color=_GREY, label="shown")
    axis.plot(arrivals, frames, ".", ms=3, color=_GREEN, label="arrived and decoded")
    axis.set(ylabel="frame", title="Every frame: when it arrived, when it was shown")
    axis.legend(loc="upper left", fontsize=8)


def _transfers(axis: Any, log: SessionLog) -> None:
    """The paper's transmission time: request to arrival of a batch, shared by the frames it shows."""
    batches = [f for f in log.fetches if f.kind is not BatchKind.TABLES]
    frames = np.array([log.shown[f.position].frames for f in batches])
    took = 1e3 * np.array([f.arrival_s - f.request_s for f in batches]) / np.maximum(frames, 1)
    axis.axhline(1e3 / log.offers.fps, color=_GREY, linestyle="--", label="a frame on the screen")
    axis.plot([f.arrival_s for f in batches], took, ".", color=_GREEN, label="a frame on its way")
    every = 1e3 * log.frame_times
    title = "Time a frame was on its way, its share of round trip and key included"
    if len(every):
        title += f": mean {every.mean():.0f} ms, 95 % under {np.percentile(every, 95):.0f} ms"
    axis.set(ylabel="ms", title=title, ylim=(0, None))
    axis.legend(loc="upper left", fontsize=8)


def plot_tiles(axis: Any, log: SessionLog) -> None:
    """A row for every tile: when it could be shown, from when it came late, and when it was lacking in sight."""
    assert log.tiles is not None, "only of a session in which tiles were fetched by view"
    fps, count = log.offers.fps, log.offers.manifest.tiles
    for position, entry in enumerate(log.shown):
        end_s = entry.start_s + entry.frames / fps
        for event in log.tiles.came(position):
            from_s, late = max(entry.start_s, event.ready_s), event.ready_s > entry.start_s
            if from_s < end_s:
                axis.plot([from_s, end_s], [event.tile] * 2, color=_ORANGE if late else _GREEN, linewidth=4)
    ticks, tiles = np.nonzero(log.tiles.missing)
    axis.plot(log.tiles.tick_times[ticks], tiles, "|", color=_RED, ms=6)
    axis.set_yticks(range(count), [str(tile + 1) for tile in range(count)], fontsize=8)
    title = "Tiles that can be shown (orange: they came late; red: lacking in sight)"
    axis.set(ylabel="tile", title=title, ylim=(count - 0.5, -0.5))


def tile_words(figures: TileFigures) -> str:
    """Return what was fetched and what was lacking."""
    sizes = ", ".join(f"{size / 1e3:.0f}" for size in figures.bytes)
    return (
        f"{100 * figures.fetched:.0f} % fetched, {figures.late} after their segment had begun; "
        f"one in sight was lacking for {figures.missing_s:.2f} s; kB of each: {sizes}"
    )


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
    if log.metrics.tiles is not None:
        rows.append(("tiles", tile_words(log.metrics.tiles)))
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


def _page(log: SessionLog, directory: Path, viewer: Viewer | None) -> str:
    named = [*_readable(log), *_place_rows(log, viewer)]
    rows = "".join(f"<tr><th>{html.escape(a)}</th><td>{html.escape(b)}</td></tr>" for a, b in named)
    extra = (
        '<img src="screen.png" alt="the worst segment shown, beside the best rung">'
        if (directory / "screen.png").exists()
        else ""
    )
    picture = '<img src="session.png" alt="throughput, rungs, buffer, quality and arrivals over time">'
    place = '<img src="region.png" alt="the viewing region and the walk of the viewer from above">' if viewer else ""
    return page("airgs-play", f"<table>{rows}</table>{_rung_table(log)}{extra}{picture}{place}")


def _rung_table(log: SessionLog) -> str:
    """Return what the package says of its rungs: the mean picture of its region, and the worst one."""
    cells = [
        (str(rung["rung"]), *("-" if rung[name] is None else f"{rung[name]:.2f} dB" for name in ("psnr", "worst")))
        for rung in _rung_record(log)
    ]
    head = "<tr><th>rung, best first</th><th>PSNR</th><th>worst picture</th></tr>"
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in cells)
    return f"<h2>What the package claims</h2><table>{head}{body}</table>"

"""Policies compared on the same links: every trace from several seeded offsets, paired, with bootstrap intervals.

Bandwidth is taken as given whatever a policy does (replay), so cross traffic that would have reacted is not modelled.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec._files import write_json
from airgs_codec.errors import ConfigError, TransportError
from airgs_codec.package.store import open_package
from airgs_codec.package.tables import FileKind
from airgs_codec.play.catalogue import Catalogue
from airgs_codec.play.frame_mode import CHOOSERS, frame_table, simulate_frames
from airgs_codec.play.link import Link
from airgs_codec.play.regret import session_bound
from airgs_codec.play.session import simulate
from airgs_codec.play.settings import SessionSettings
from airgs_codec.play.trace import Trace, open_trace
from airgs_codec.progress import Progress, silent

FEASIBLE_START_S = 2.0  # start-up by which the smallest rungs must play without a stall
RESAMPLES = 2000
PERCENTILES = tuple(range(101))  # of the frame times that are kept of a session
FIGURES = (
    "psnr_mean",
    "psnr_p5",
    "stall_ratio",
    "startup_s",
    "switches",
    "change_db",
    "bytes_per_frame",
    "wasted",
    "utilisation",
    "infeasible",
    "late",
    "regret",
    "qoe",
    "frame_ms_mean",
    "frame_ms_p50",
    "frame_ms_p95",
    "frame_ms_max",
)
KINDS = (FileKind.KEY, FileKind.STATE, FileKind.SIDECARS, FileKind.INIT, FileKind.MANIFESTS)  # of bytes
Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class StudySettings:
    """What is compared on what."""

    policies: tuple[str, ...]
    traces: tuple[str, ...]  # as `open_trace` takes them
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
        if self.offsets < 1 or self.jobs < 1:
            raise ConfigError(f"expected at least one offset and job, got {self.offsets} and {self.jobs}")


@dataclass(frozen=True, slots=True, eq=False)
class Study:
    """Rows of every session and of every frame-mode run, in the order of traces, offsets and policies."""

    settings: StudySettings
    package: str
    rows: tuple[Row, ...]
    frame_rows: tuple[Row, ...]

    def of(self, policy: str, figure: str, feasible: bool | None = None) -> NDArray[np.float64]:
        """A figure of every session of a policy, NaN where it has none."""
        rows = [r for r in self.rows if r["policy"] == policy and (feasible is None or r["feasible"] == feasible)]
        return np.array([math.nan if r[figure] is None else float(r[figure]) for r in rows])


def offsets_of(trace: Trace, count: int, seed: int) -> list[float]:
    """Where sessions begin in a trace: drawn from the seed and the trace's name, to the millisecond."""
    random = np.random.default_rng([seed, *trace.name.encode()])
    return [round(float(v), 3) for v in random.uniform(0, trace.duration_s, count)]


def is_feasible(c: Catalogue, link: Link, settings: SessionSettings, loops: int) -> bool:
    """Whether a player that always takes the smallest rung shows all of it without a stall from FEASIBLE_START_S on."""
    at = link.arrival_s(c.wire_bytes([c.manifest_bytes]), 0.0)
    due = FEASIBLE_START_S
    inits = c.manifest.init_files(*c.rungs[int(np.argmin(c.bytes_from_scratch[0]))])
    first = c.wire_bytes([c.manifest.files[path].bytes for path in inits])
    for position in range(loops * len(c.seconds)):
        segment = position % len(c.seconds)
        room = due + c.seconds[segment] - settings.buffer_s
        asked = max(at - link.rtt_s if settings.pipelined and position else at, room)
        size = int(c.bytes_from_scratch[segment].min()) + (0 if position else first)
        at = link.trace.arrival_s(size, max(at, asked + link.rtt_s))
        if at + settings.decode_frame_s > due:
            return False
        due += c.seconds[segment]
    return True


def run_study(
    package: Path,
    settings: StudySettings,
    progress: Progress = silent,
) -> Study:
    """Every policy on every link. Raises TransportError, ConfigError, FormatError."""
    for trace in settings.traces:
        open_trace(trace)  # one that cannot be read is told before minutes of work
    rows: list[Row] = []
    frame_rows: list[Row] = []
    tasks = [(package, trace, settings) for trace in settings.traces]
    progress("sessions", 0, len(tasks))
    with ProcessPoolExecutor(settings.jobs) as pool:
        for done, (some, frames) in enumerate(pool.map(_one_trace, tasks), 1):
            rows += some
            frame_rows += frames
            progress("sessions", done, len(tasks))
    return Study(settings, package.name, tuple(rows), tuple(frame_rows))


def _one_trace(task: tuple[Path, str, StudySettings]) -> tuple[list[Row], list[Row]]:
    path, name, settings = task
    package = open_package(path)
    c = Catalogue.of(package)
    whole = open_trace(name)
    loops = c.loops(settings.session.loops)
    rows, frame_rows = [], []
    for offset in offsets_of(whole, settings.offsets, settings.seed):
        trace = whole.cut(offset, settings.scale).ending(settings.end)
        link = Link.over(trace, settings.rtt_s)
        try:
            feasible = is_feasible(c, link, settings.session, loops)
        except TransportError:
            feasible = False
        start = {"trace": trace.name, "offset_s": offset, "scale": settings.scale, "mean_bps": trace.mean_bps}
        for policy in settings.policies:
            log = simulate(c, link, policy, replace(settings.session, loops=loops))
            bound = session_bound(log)
            row = start | {"policy": policy, "feasible": feasible} | asdict(log.metrics)
            row |= {"bound": bound, "regret": None if bound is None else bound - log.mean_quality}
            shown = sum(s.frames for s in log.shown)
            row |= {f"{kind}_kb_frame": log.bytes_by_kind.get(kind, 0) / shown / 1e3 for kind in KINDS}
            row["frame_ms_percentiles"] = (1e3 * np.percentile(log.frame_times, PERCENTILES)).round(3).tolist()
            rows.append(row)
        for chooser in CHOOSERS:
            frames = simulate_frames(c, link, chooser, loops)
            frame_rows.append(start | {"chooser": chooser} | frame_table(frames))
    return rows, frame_rows


def interval(values: NDArray[np.float64], groups: Sequence[str], seed: int = 0) -> tuple[float, float, float]:
    """Mean and its 95 % interval: percentile bootstrap over whole traces, whose offsets are not independent.

    values (n,), NaN where there is no figure; groups (n,) name the trace of each.
    """
    names = sorted(set(groups))
    member = np.array([names.index(g) for g in groups], np.intp)
    known = np.isfinite(values)
    if not known.any():
        return math.nan, math.nan, math.nan
    sums = np.bincount(member[known], values[known], len(names))
    counts = np.bincount(member[known], minlength=len(names)).astype(np.float64)
    picks = np.random.default_rng(seed).integers(0, len(names), (RESAMPLES, len(names)))
    drawn = counts[picks].sum(axis=1)
    means = sums[picks].sum(axis=1)[drawn > 0] / drawn[drawn > 0]
    low, high = np.percentile(means, [2.5, 97.5])
    return float(sums.sum() / counts.sum()), float(low), float(high)


def summarise(study: Study, feasible: bool | None = None) -> list[Row]:
    """One row a policy: every figure with its interval, and its mean difference to the first policy, paired."""
    out: list[Row] = []
    wanted = [r for r in study.rows if feasible is None or r["feasible"] == feasible]
    first = study.settings.policies[0]
    traces = [r["trace"] for r in wanted if r["policy"] == first]
    for policy in study.settings.policies:
        row: Row = {"policy": policy, "sessions": len(traces)}
        for figure in (*FIGURES, *(f"{kind}_kb_frame" for kind in KINDS)):
            values = study.of(policy, figure, feasible)
            row[figure] = interval(values, traces)
            row[f"{figure}_difference"] = interval(values - study.of(first, figure, feasible), traces)
        stalls = study.of(policy, "stall_s", feasible)
        played = study.of(policy, "played_s", feasible)
        row["stall_share"] = float(stalls.sum() / (stalls.sum() + played.sum())) if len(played) else math.nan
        out.append(row)
    return out


def frame_summary(frame_rows: Sequence[Row]) -> list[Row]:
    """One row a chooser of frame mode: means over its runs, and the worst frame as a share of the unpruned one's."""
    out: list[Row] = []
    by_chooser = {name: [r for r in frame_rows if r["chooser"] == name] for name in CHOOSERS}
    for name, rows in by_chooser.items():
        row: Row = {"chooser": name, "runs": len(rows)}
        for figure in rows[0]:
            if figure not in ("trace", "offset_s", "scale", "mean_bps", "chooser", "frames"):
                row[figure] = float(np.nanmean([r[figure] for r in rows]))
        for figure in ("paper_max_ms", "link_max_ms"):
            shares = [a[figure] / b[figure] for a, b in zip(rows, by_chooser["unpruned"], strict=True) if b[figure] > 0]
            row[f"{figure}_share"] = float(np.nanmedian(shares))
        out.append(row)
    return out


def study_record(study: Study) -> Row:
    """All tables; a figure that is not known is NaN, and null in JSON."""
    return {"package": study.package, "all": summarise(study), "feasible": summarise(study, True)} | {
        "frame_mode": frame_summary(study.frame_rows)
    }


def write_rows(study: Study, folder: Path) -> None:
    """sessions.csv, frames.csv and study.json. Raises ConfigError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, rows in (("sessions", study.rows), ("frames", study.frame_rows)):
            if rows:
                kept = [{k: v for k, v in row.items() if k != "frame_ms_percentiles"} for row in rows]
                with (folder / f"{name}.csv").open("w", newline="") as file:
                    writer = csv.DictWriter(file, list(kept[0]))
                    writer.writeheader()
                    writer.writerows(kept)
        write_json(folder / "study.json", study_record(study))
    except OSError as error:
        raise ConfigError(f"{folder}: cannot write the study: {error}") from error

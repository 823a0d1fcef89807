"""Who did which job, and when: a page with a Gantt chart and a table of the kinds of jobs."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from airgs_codec._report import Page, Picture, html_table
from airgs_codec.jobs.job import Record

NAME = "jobs.html"  # of the page where it lies beside others
LINK = f'<p><a href="{NAME}">Who did which job, and when</a></p>'
IDLE = 0.5  # share of the time of all workers under which fewer would do


def write_report(path: Path, records: Sequence[Record]) -> None:
    """Write the page; there is at least one record. Raises ConfigError without matplotlib, OSError."""
    chart = Picture("A row for each worker, a colour for each kind of job.", partial(_chart, records))
    rows = []
    for kind in _kinds(records):
        some = [record for record in records if record.kind == kind]
        seconds, size = [record.seconds for record in some], sum(record.bytes for record in some) / 1e6
        rows.append((kind, str(len(some)), f"{sum(seconds):.1f}", f"{max(seconds):.1f}", f"{size:.1f}"))
    head = ("kind", "jobs", "seconds", "longest", "MB of results")
    Page("Jobs", jobs_answer(records), [chart], {"Kinds of jobs": html_table(rows, head)}).write(path)


def jobs_answer(records: Sequence[Record]) -> dict[str, str]:
    """How busy workers were, and what took longest, in whole sentences."""
    workers = len({record.worker for record in records})
    begun = min(record.begun for record in records)
    wall_s = max(record.begun + record.seconds for record in records) - begun
    busy_s = sum(record.seconds for record in records)
    share = busy_s / (wall_s * workers) if wall_s else 1.0
    spent = {kind: sum(r.seconds for r in records if r.kind == kind) for kind in _kinds(records)}
    longest = max(spent, key=lambda kind: spent[kind])
    return {
        "good": f"{len(records)} jobs by {workers} workers in {wall_s:.1f} s, {busy_s:.1f} s of work: workers were "
        f"busy {share:.0%} of the time. {longest} took most of it, {spent[longest]:.1f} s. Results of runs before this "
        "one count with the times when they were made.",
        "change": "Fewer workers would take hardly longer." if workers > 1 and share < IDLE else "",
    }


def _kinds(records: Sequence[Record]) -> list[str]:
    return list(dict.fromkeys(record.kind for record in records))


def _chart(records: Sequence[Record], axis: Any) -> None:
    """A bar for each job, a row for each worker."""
    workers, begun = sorted({record.worker for record in records}), min(record.begun for record in records)
    for number, kind in enumerate(_kinds(records)):
        colour = f"C{number % 10}"
        for place, worker in enumerate(workers):
            some = [r for r in records if r.kind == kind and r.worker == worker]
            bars = [(r.begun - begun, r.seconds) for r in some]
            axis.broken_barh(bars, (place - 0.4, 0.8), color=colour, edgecolor="white", linewidth=0.5)
        axis.plot([], [], color=colour, linewidth=6, label=kind)
    axis.set_yticks(range(len(workers)), workers, fontsize=8)
    axis.set_xlabel("seconds")
    axis.legend(ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False, fontsize=8, handlelength=1)

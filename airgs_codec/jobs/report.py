"""Who did which job, and when: a page with a Gantt chart and a table of the kinds of jobs."""

from __future__ import annotations

import html
import io
from collections.abc import Sequence
from pathlib import Path

from airgs_codec._report import new_figure, page
from airgs_codec.jobs.job import Record
from airgs_codec.places.whole import write_bytes

NAME = "jobs.html"  # of the page where it lies beside others
WIDTH, ROW_HEIGHT = 11.0, 0.35  # inches
STYLE = "td,th{padding:.1rem 1.2rem .1rem 0;text-align:right}td:first-child,th:first-child{text-align:left}"


def write_report(path: Path, records: Sequence[Record]) -> None:
    """Write the page; there is at least one record. Raises ConfigError without matplotlib, OSError."""
    kinds = list(dict.fromkeys(record.kind for record in records))
    workers = sorted({record.worker for record in records})
    begun = min(record.begun for record in records)
    wall_s = max(record.begun + record.seconds for record in records) - begun
    busy_s = sum(record.seconds for record in records)
    share = busy_s / (wall_s * len(workers)) if wall_s else 1.0
    words = (
        f"<p>{len(records)} jobs by {len(workers)} workers in {wall_s:.1f} s, {busy_s:.1f} s of work: workers were "
        f"busy {share:.0%} of the time. Results of runs before this one count with the times when they were made.</p>"
    )
    head = "<tr><th>kind</th><th>jobs</th><th>seconds</th><th>longest</th><th>MB of results</th></tr>"
    rows = []
    for kind in kinds:
        some = [record for record in records if record.kind == kind]
        seconds = [record.seconds for record in some]
        size = sum(record.bytes for record in some) / 1e6
        cells = [html.escape(kind), len(some), f"{sum(seconds):.1f}", f"{max(seconds):.1f}", f"{size:.1f}"]
        rows.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    body = f"{words}{_chart(records, kinds, workers, begun)}<table>{head}{''.join(rows)}</table>"
    write_bytes(path, page("Jobs", body, style=STYLE).encode())


def _chart(records: Sequence[Record], kinds: Sequence[str], workers: Sequence[str], begun: float) -> str:
    """A bar for each job, a row for each worker, as SVG."""
    from matplotlib import colormaps

    figure = new_figure(WIDTH, 1.2 + ROW_HEIGHT * len(workers))
    axes = figure.add_subplot()
    for number, kind in enumerate(kinds):
        for place, worker in enumerate(workers):
            some = [r for r in records if r.kind == kind and r.worker == worker]
            bars = [(r.begun - begun, r.seconds) for r in some]
            colour = colormaps["tab10"](number % 10)
            axes.broken_barh(bars, (place - 0.4, 0.8), color=colour, edgecolor="white", linewidth=0.5)
        axes.plot([], [], color=colormaps["tab10"](number % 10), linewidth=6, label=kind)
    axes.set_yticks(range(len(workers)), list(workers))
    axes.set_xlabel("seconds")
    axes.legend(ncols=len(kinds), loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
    drawn = io.StringIO()
    figure.savefig(drawn, format="svg")
    return drawn.getvalue()[drawn.getvalue().index("<svg") :]

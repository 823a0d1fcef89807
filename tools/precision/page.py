"""The page of the report: questions, pictures, and conclusions that are computed from the rows."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template

from tools.precision.panels import SECTIONS, Panel, Section
from tools.precision.pictures import picture_path
from tools.precision.rows import Row

PAGE = Template(
    """# Error against run time

This page and its pictures are made by the tool, sentences included: each conclusion is computed from the rows in
[work_precision.csv](work_precision.csv).

```sh not-run
$command
```

$how

$sections"""
)
HOW = (
    "Seconds are those of CPU time, of all threads together, since other work changes them less than those by the "
    "clock on the wall, which are in the table, too; the kernels have one thread. Points are medians, and bars reach "
    "from quartile to quartile."
)
WIDTH = 120


@dataclass(frozen=True, slots=True)
class Made:
    """How the rows came about, in words."""

    command: str
    machine: str  # whole sentences
    scenes: Sequence[str]


def conclude(section: Section, panel: Panel, rows: list[Row]) -> str:
    """The conclusion of a panel; '' without the rows that it needs."""
    some = section.rows_of(panel, rows)
    return panel.conclusion(some) if some else ""


def page(rows: list[Row], made: Made) -> str:
    """The page in Markdown."""
    parts = [f"## {s.title}\n\n" + "\n\n".join(_section(s, rows)) for s in SECTIONS if _has_rows(s, rows)]
    how = wrapped(f"{made.machine} {HOW} Scenes: {'; '.join(made.scenes)}.")
    return PAGE.substitute(command=made.command, how=how, sections="\n\n".join(parts)) + "\n"


def _has_rows(section: Section, rows: list[Row]) -> bool:
    return any(row.section == section.name for row in rows)


def _section(section: Section, rows: list[Row]) -> Iterator[str]:
    yield wrapped(section.about)
    yield f"![{section.title}]({picture_path(Path(), section).name})"
    for panel in section.panels:
        words = conclude(section, panel, rows)
        if words:
            yield wrapped(f"**{panel.question}** {words}")


def wrapped(text: str) -> str:
    """A paragraph in lines of at most WIDTH characters."""
    return textwrap.fill(text, WIDTH, break_long_words=False, break_on_hyphens=False)

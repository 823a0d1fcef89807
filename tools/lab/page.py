"""What an experiment gives: pictures and tables; in Markdown with pictures and JSON beside it.

`write_page` makes its files, `text_of` what the terminal shows, `update` puts it into a document, whose sentences are
written by hand.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from airgs_codec import _report
from airgs_codec._report import PagePicture, Section, Table
from airgs_codec.errors import ConfigError
from airgs_codec.places.whole import write_bytes, write_json

COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#8c564b", "#17becf", "#7f7f7f")
Row = dict[str, Any]
listed = partial(_report.listed, most=sys.maxsize)


@dataclass(frozen=True, slots=True, eq=False)
class Page:
    """What an experiment gives; `failed`: what ought to be true was found not to be."""

    sections: Sequence[Section]  # their words are for the terminal alone
    how: str = ""  # it was measured, for the terminal and figures.json
    failed: bool = False
    more: Mapping[str, Any] = field(default_factory=dict)  # figures for the JSON alone
    data: Sequence[Table] = ()  # what pictures are drawn from, for the JSON and files alone

    def tables(self) -> list[Table]:
        """All tables, those that the page does not show last."""
        return [*(one for section in self.sections for one in section.tables), *self.data]


@dataclass(frozen=True, slots=True)
class Made:
    name: str  # of the experiment, or of what is published of it
    question: str
    command: str
    machine: str
    seconds: float
    date: str  # YYYY-MM-DD
    commit: str  # of the code, with a + where it had changed since
    format: int  # of packages

    def said(self) -> str:
        took = f"{self.date}, {self.seconds:,.0f} s"
        return f"Measured {took}, commit {self.commit}, format {self.format}, `{self.name}`."


def rows_of(values: Iterable[Any]) -> list[Row]:
    return [dataclasses.asdict(value) for value in values]


def text_of(page: Page) -> str:
    lines = [page.how, *(words for one in page.sections for words in (one.question, one.answer))]
    lines += [f"\n{one.to_text()}" for section in page.sections for one in section.tables if one.rows]
    return "\n".join(filter(None, lines))


def body_of(page: Page, made: Made) -> str:
    pictures = [picture_link(one) for section in page.sections for one in section.pictures]
    tables = [markdown_table(one) for section in page.sections for one in section.tables if one.rows]
    return "\n\n".join([*pictures, *tables, made.said()])


def picture_link(one: PagePicture) -> str:
    return f"![{one.caption}]({one.name}.png)"


def markdown_table(one: Table) -> str:
    """A table of a document, without blanks that its reader does not see; columns of numbers are right-aligned."""
    head, *lines = ([cell.replace("|", "\\|") for cell in line] for line in one.lines())
    numeric = (any(isinstance(row.get(key), int | float) for row in one.rows) for key in one.shown_columns())
    rule = ["---:" if number else "---" for number in numeric]
    return "\n".join(f"|{'|'.join(line)}|" for line in (head, rule, *lines))


def write_page(page: Page, made: Made, folder: Path) -> None:
    """Write NAME.md, the pictures that the page shows, and NAME.json with all figures.

    Raises ConfigError and OSError.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for picture in (picture for section in page.sections for picture in section.pictures):
        picture.write(folder / f"{picture.name}.png")
    figures = {one.name: list(one.rows) for one in page.tables()}
    write_json(folder / f"{made.name}.json", dataclasses.asdict(made) | {"figures": figures} | dict(page.more))
    write_bytes(folder / f"{made.name}.md", f"# {made.question}\n\n{body_of(page, made)}\n".encode())


def update(document: Path, name: str, text: str) -> None:
    """Put a text between the marks of a name in a document. Raises ConfigError where they are not there."""
    begin, end = (f"<!-- tools.lab {name}: {word} -->" for word in ("begin", "end"))
    whole = document.read_text(encoding="utf-8")
    before, after = whole.partition(begin)[0], whole.partition(end)[2]
    if begin not in whole or end not in whole:
        raise ConfigError(f"{document}: expected the lines {begin!r} and {end!r}")
    write_bytes(document, f"{before}{begin}\n\n{text}\n\n{end}{after}".encode())


def plain_log_ticks(axis: Any, most: int = 6) -> None:
    """Label a logarithmic axis with at most `most` plain numbers, when its limits are final.

    matplotlib labels minor ticks too where an axis spans less than a decade, one over the other.
    """
    from matplotlib.ticker import MaxNLocator, NullLocator

    low, high = sorted(axis.get_view_interval())
    decades = [10.0**power for power in range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)]
    if high < 4 * low:
        ticks = [tick for tick in MaxNLocator(most - 1).tick_values(low, high) if low <= tick <= high]
    else:
        for steps in ((1, 1.5, 2, 3, 4, 5, 6, 7, 8, 9), (1, 2, 5), (1, 3), (1,)):
            ticks = [step * decade for decade in decades for step in steps if low <= step * decade <= high]
            if len(ticks) <= most:
                break
    axis.set_ticks(ticks[:: math.ceil(len(ticks) / most)])
    axis.set_major_formatter("{x:g}")
    axis.set_minor_locator(NullLocator())

"""The one page of an experiment: question, picture, answer, table; in Markdown with pictures and JSON beside it.

A page is a value. `write_page` makes its files, `text_of` what the terminal shows, `update` puts it into a document.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from airgs_codec._report import new_figure, save_figure, table
from airgs_codec.errors import ConfigError
from airgs_codec.places.whole import write_bytes, write_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH = 120  # of lines of text
NOTHING = "-"  # in place of a figure that is not there
COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#8c564b", "#17becf", "#7f7f7f")
DPI = 110
Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Table:
    """Rows, which go whole into the JSON, and the columns that the page shows: some by their headings, or all."""

    name: str
    rows: Sequence[Mapping[str, Any]]
    columns: Mapping[str, tuple[str, str]] = field(default_factory=dict)  # key -> heading, format; empty: all keys
    once: int = 0  # first columns, whose cells are empty where a row has the same as the one above

    @property
    def keys(self) -> list[str]:
        return list(self.columns or dict.fromkeys(key for row in self.rows for key in row))

    @property
    def head(self) -> list[str]:
        return [self.columns[key][0] if self.columns else key.replace("_", " ") for key in self.keys]

    def cells(self) -> list[list[str]]:
        forms = {key: form for key, (_, form) in self.columns.items()}
        lines = [[shown(row.get(key), forms.get(key, "")) for key in self.keys] for row in self.rows]
        again = [False, *(a[: self.once] == b[: self.once] for a, b in itertools.pairwise(lines))]
        return [[""] * self.once + line[self.once :] if one else line for one, line in zip(again, lines, strict=True)]

    def numeric(self) -> list[bool]:
        return [any(_is_number(row.get(key)) for row in self.rows) for key in self.keys]


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A picture `name`.png; `draw` fills a figure, which gets the style of all pictures."""

    name: str
    caption: str
    draw: Callable[[Figure], None]
    size: tuple[float, float] = (9.0, 4.5)  # inches
    grid: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """An answer in about two sentences, to a question of its own where a page has several sections."""

    answer: str
    question: str = ""  # empty: that of the experiment
    pictures: Sequence[Picture] = ()
    tables: Sequence[Table] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Page:
    """What an experiment gives; `failed`: what ought to be true was found not to be."""

    sections: Sequence[Section]
    how: str = ""  # it was measured
    failed: bool = False
    more: Mapping[str, Any] = field(default_factory=dict)  # figures for the JSON alone
    data: Sequence[Table] = ()  # what pictures are drawn from, for the JSON and files alone
    brief: Sequence[Table] = ()  # what the README shows of it

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
        return f"Measured {self.date} in {self.seconds:,.0f} s, commit {self.commit}, format {self.format}."


def rows_of(values: Iterable[Any]) -> list[Row]:
    return [dataclasses.asdict(value) for value in values]


def shown(value: Any, form: str = "") -> str:
    """A value as a cell of a table; a number without a format has four digits, or all before its point."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return NOTHING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not _is_number(value):
        return str(value)
    return format(value, form or (",.0f" if isinstance(value, int) or abs(value) >= 1000 else ".4g")).replace("%", " %")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def listed(words: Sequence[str]) -> str:
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def wrapped(text: str) -> str:
    """Paragraphs, or items of a list, a line each, in lines of at most WIDTH characters."""
    plain = textwrap.TextWrapper(WIDTH, break_long_words=False, break_on_hyphens=False)
    item = textwrap.TextWrapper(WIDTH, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)
    return "\n".join((item if line.startswith("- ") else plain).fill(line) for line in text.split("\n"))


def text_of(page: Page) -> str:
    lines: list[str] = []
    for section in page.sections:
        lines += [wrapped(f"{section.question} {section.answer}".strip())]
        for one in (one for one in section.tables if one.rows):
            lines += ["", *table(one.head, one.cells())]
        lines.append("")
    return "\n".join(lines).rstrip()


def markdown(page: Page, made: Made) -> str:
    return f"# {made.question}\n\n{body_of(page, made)}\n"


def body_of(page: Page, made: Made) -> str:
    return "\n\n".join(_parts(page, made))


def _parts(page: Page, made: Made) -> Iterator[str]:
    if page.how:
        yield wrapped(page.how)
    for section in page.sections:
        if section.question:
            yield f"## {section.question}"
        yield from (f"![{picture.caption}]({picture.name}.png)" for picture in section.pictures)
        if section.answer:
            yield wrapped(section.answer)
        yield from (markdown_table(one) for one in section.tables if one.rows)
    yield wrapped(made.said())


def markdown_table(one: Table) -> str:
    """A table of a document, without blanks that its reader does not see."""
    rule = ["---:" if number else "---" for number in one.numeric()]
    cells = [[cell.replace("|", "\\|") for cell in line] for line in one.cells()]
    return "\n".join(f"|{'|'.join(line)}|" for line in (one.head, rule, *cells))


def write_page(page: Page, made: Made, folder: Path) -> None:
    """Write NAME.md, the pictures that the page shows, and NAME.json with all figures.

    Raises ConfigError without matplotlib, OSError.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for picture in (picture for section in page.sections for picture in section.pictures):
        write_picture(picture, folder / f"{picture.name}.png")
    figures = {one.name: list(one.rows) for one in page.tables()}
    write_json(folder / f"{made.name}.json", dataclasses.asdict(made) | {"figures": figures} | dict(page.more))
    write_bytes(folder / f"{made.name}.md", markdown(page, made).encode())


def write_picture(picture: Picture, path: Path) -> None:
    """Draw in the style that all pictures have. Raises ConfigError without matplotlib."""
    figure = new_figure(*picture.size)
    picture.draw(figure)
    for axes in figure.axes:
        if picture.grid:
            axes.grid(alpha=0.3)
        if legend := axes.get_legend():
            for words in legend.get_texts():
                words.set_fontsize(8)
    save_figure(figure, path, DPI)


def update(document: Path, name: str, text: str) -> None:
    """Put a text between the marks of a name in a document. Raises ConfigError where they are not there."""
    begin, end = (f"<!-- tools.lab {name}: {word} -->" for word in ("begin", "end"))
    whole = document.read_text(encoding="utf-8")
    before, after = whole.partition(begin)[0], whole.partition(end)[2]
    if begin not in whole or end not in whole:
        raise ConfigError(f"{document}: expected the lines {begin!r} and {end!r}")
    write_bytes(document, f"{before}{begin}\n\n{text}\n\n{end}{after}".encode())

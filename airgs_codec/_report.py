"""The one page of every report: sections of words, pictures and tables.

matplotlib takes half a second to import: it is imported here alone, and only when a figure is made.
"""

from __future__ import annotations

import base64
import html
import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from airgs_codec.errors import ConfigError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BLUE, ORANGE, GREEN, RED, GREY = "#2a6fbb", "#e08a1e", "#3a9a5b", "#c8453b", "#8a8f98"
HEADS = {
    "good": "How good it is", "wrong": "What went wrong", "useless": "What is of no use", "change": "What to change",
}  # fmt: skip
STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:70rem;margin:1.5rem auto;padding:0 1rem;color:#222;"
    "background:#fff;overflow-wrap:break-word}h1{font-size:1.5rem}h2{font-size:1rem;margin:1rem 0 0}p{margin:0}"
    ".pictures{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,24rem),1fr));gap:1rem;margin-top:1rem}"
    "figure{margin:0;overflow-x:auto}figcaption{font-size:14px;color:#555}img{width:100%;display:block}"
    ".pictures:empty{display:none}.file{grid-column:1/-1}.file img{min-width:48rem}"
    "details{margin-top:1rem;overflow-x:auto}summary{cursor:pointer;font-weight:600}"
    "table{border-collapse:collapse;font-size:14px}tr:nth-child(even){background:#f4f4f6}"
    "td{padding:.15rem .8rem .15rem 0;vertical-align:top}tr:first-child,td:first-child{font-weight:600}"
)
Form = str | Callable[[Any], str]  # of the values of a column: a format specification, or what makes text of them


def cell(value: Any, form: Form = "") -> str:
    """Return the text of a cell; a number without a format has four digits, or all before its point."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    if callable(form):
        return form(value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not isinstance(value, int | float):
        return str(value)
    return format(value, form or (",.0f" if isinstance(value, int) or abs(value) >= 1000 else ".4g")).replace("%", " %")


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of plain values by their names, and the columns that are shown of them: some by their headings, or all."""

    name: str
    rows: Sequence[Mapping[str, Any]]
    columns: Mapping[str, tuple[str, Form]] = field(default_factory=dict)  # by key: heading, form; empty: all keys

    def shown_columns(self) -> Mapping[str, tuple[str, Form]]:
        return self.columns or {key: (key.replace("_", " "), "") for row in self.rows for key in row}

    def lines(self) -> list[list[str]]:
        """Return the cells of the heading, then of each row."""
        columns = self.shown_columns()
        heads = [head for head, _ in columns.values()]
        return [heads, *([cell(row.get(key), form) for key, (_, form) in columns.items()] for row in self.rows)]

    def to_text(self) -> str:
        """Return right-aligned columns under their headings."""
        lines = self.lines()
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        return "\n".join("  ".join(map(str.rjust, line, widths)).rstrip() for line in lines)

    def to_html(self) -> str:
        """Return a table that opens on demand."""
        rows = ("".join(f"<td>{html.escape(cell)}</td>" for cell in line) for line in self.lines())
        body = "".join(f"<tr>{row}</tr>" for row in rows)
        return f"<details><summary>{html.escape(self.name)}</summary><table>{body}</table></details>"


@dataclass(frozen=True, slots=True, eq=False)
class PagePicture:
    """A chart that `draw` draws in a figure, or what `save` writes to the file `name` in the folder of the page."""

    name: str
    caption: str
    draw: Callable[[Figure], None] | None = None
    size: tuple[float, float] = (4.2, 2.7)  # inches: legible on a screen 390 pixels wide, two fit in a line
    save: Callable[[Path], object] | None = None

    def write(self, target: Path | io.BytesIO, form: str | None = None) -> None:
        """Draw the chart in a form, or in that of the name's ending. Raises ConfigError where that cannot be done."""
        from matplotlib import rc_context
        from matplotlib.figure import Figure

        assert self.draw, self.name
        with rc_context({"axes.grid": True, "grid.alpha": 0.3, "legend.fontsize": 8}):
            figure = Figure(figsize=self.size, layout="constrained")
            forms = sorted(figure.canvas.get_supported_filetypes())
            if isinstance(target, Path) and target.suffix[1:].lower() not in forms:
                raise ConfigError(f"{target}: expected a name that ends in .{', .'.join(forms)}")
            self.draw(figure)
            try:
                figure.savefig(target, format=form, dpi=110)
            except OSError as error:
                raise ConfigError(f"{target}: cannot write the picture: {error.strerror or error}") from error

    def to_html(self) -> str:
        kind, source, caption = "file", html.escape(self.name), html.escape(self.caption)
        if self.draw:
            self.write(drawn := io.BytesIO(), "svg")
            kind, source = "chart", f"data:image/svg+xml;base64,{base64.b64encode(drawn.getvalue()).decode()}"
        image = f'<img src="{source}" alt="{caption}">'
        return f'<figure class="{kind}">{image}<figcaption>{caption}</figcaption></figure>'


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """Words that answer a question, and the pictures and tables behind them; each may be missing."""

    answer: str
    question: str = ""
    pictures: Sequence[PagePicture] = ()
    tables: Sequence[Table] = ()

    def to_html(self) -> str:
        heading = f"<h2>{html.escape(self.question)}</h2>" if self.question else ""
        pictures = "".join(picture.to_html() for picture in self.pictures)
        tables = "".join(table.to_html() for table in self.tables if table.rows)
        return f'{heading}<p>{html.escape(self.answer)}</p><div class="pictures">{pictures}</div>{tables}'


@dataclass(frozen=True, slots=True, eq=False)
class Page:
    sections: Sequence[Section]
    title: str
    reload_s: int | None = None  # seconds after which a browser loads it again, where it changes

    def write(self, folder: Path) -> Path:
        """Write index.html and the files of its pictures; return its path. Raises ConfigError."""
        again = "" if self.reload_s is None else f'<meta http-equiv="refresh" content="{self.reload_s}">'
        title, body = html.escape(self.title), "".join(section.to_html() for section in self.sections)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for picture in (picture for section in self.sections for picture in section.pictures):
                if picture.save:
                    picture.save(folder / picture.name)
            (folder / "index.html").write_text(
                f'<!doctype html><html lang="en"><meta charset="utf-8">{again}<title>{title}</title>'
                f'<meta name="viewport" content="width=device-width,initial-scale=1"><style>{STYLE}</style>'
                f"<h1>{title}</h1>{body}</html>\n",
                encoding="utf-8",
            )
        except OSError as error:
            raise ConfigError(f"{folder}: cannot write the report: {error}") from error
        return folder / "index.html"


def answered(answer: Mapping[str, str], pictures: Sequence[PagePicture], *tables: Table) -> list[Section]:
    """Return a section for each answer by the keys of HEADS that is not empty, then one of pictures and tables."""
    return [*(Section(words, HEADS[key]) for key, words in answer.items() if words), Section("", "", pictures, tables)]


def listed(names: Sequence[str], most: int = 6) -> str:
    """Return names with commas and an `and`; of more than `most` the first, and how many follow."""
    if len(names) > most:
        names = [*names[: most - 1], f"{len(names) - most + 1} more"]
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)

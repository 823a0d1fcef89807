"""What all reports share: a page that answers first, its charts, drawn with matplotlib, and tables of text and HTML.

matplotlib is an optional dependency (the extra `plot`) and half a second of imports: it is imported here alone, and
only when a figure is made.
"""

from __future__ import annotations

import html
import importlib.util
import io
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from airgs_codec.errors import ConfigError

if TYPE_CHECKING:
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

BLUE, ORANGE, GREEN, RED, GREY = "#2a6fbb", "#e08a1e", "#3a9a5b", "#c8453b", "#8a8f98"
MOST_PICTURES = 4  # of a page
IDS = re.compile(r'\bid="|\bhref="#|url\(#')  # what stands before an id in SVG
CHART = 4.2, 2.7  # inches: letters of 9 points stay legible on a screen 390 pixels wide, two fit beside each other
HEADS = {
    "good": "How good it is",
    "wrong": "What went wrong",
    "bought": "What each second bought",
    "useless": "What is of no use",
    "change": "What to change",
}
STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;max-width:70rem;margin:1.5rem auto;padding:0 1rem;"
    "color:#222;background:#fff;overflow-wrap:break-word}h1{font-size:1.5rem}"
    "dt{font-weight:600}dd{margin:0 0 .6rem;font-size:17px}"
    ".pictures{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,24rem),1fr));gap:1rem}"
    "figure{margin:0}figure.whole{grid-column:1/-1}figcaption{font-size:14px;color:#555}"
    "img,video,svg{width:100%;height:auto;display:block}.panels div{display:flex;flex-wrap:wrap}"
    ".panels img{flex:1 1 12rem;min-width:0;object-fit:cover}"
    "details{margin-top:1rem}summary{cursor:pointer;font-weight:600}.columns{overflow-x:auto}"
    "table{border-collapse:collapse;font-size:14px}tr:nth-child(even){background:#f4f4f6}"
    "th,td{padding:.15rem .8rem .15rem 0;text-align:left;vertical-align:top}.columns td,.columns th{white-space:pre}"
)


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture of a page: a chart in it, or a file beside it."""

    caption: str
    draw: Callable[[Any], None] | None = None  # draws a chart on axes
    name: str = ""  # of the file
    panels: int = 1  # equal ones beside each other, which come one below the other where the screen is narrow
    shape: tuple[int, ...] = ()  # (H, W * panels, 3) of a picture of panels

    def to_html(self, number: int) -> str:
        """The figure of this number on its page as HTML. Raises ConfigError without matplotlib."""
        name, caption, kind = html.escape(self.name), html.escape(self.caption), ""
        if self.draw is not None:
            shown = _chart(self.draw, number)
        elif name.endswith(".mp4"):
            shown = f'<video src="{name}" controls loop muted></video>'
        elif self.panels == 1:
            shown = f'<img src="{name}" alt="{caption}">'
        else:
            kind = "panels whole" if self.panels > 2 else "panels"
            ratio, parts = f"{self.shape[1] // self.panels}/{self.shape[0]}", range(self.panels)
            places = (f"aspect-ratio:{ratio};object-position:{100 * i / (self.panels - 1):g}% 0" for i in parts)
            shown = "".join(f'<img src="{name}" alt="{caption}" style="{place}">' for place in places)
        return f'<figure class="{kind}"><div>{shown}</div><figcaption>{caption}</figcaption></figure>'


def _chart(draw: Callable[[Any], None], number: int) -> str:
    """What `draw` draws on axes, as SVG whose ids no chart of another number has."""
    figure, drawn = new_figure(*CHART), io.StringIO()
    axes = figure.subplots()
    axes.grid(alpha=0.25)
    draw(axes)
    figure.savefig(drawn, format="svg")
    return IDS.sub(rf"\g<0>{number}-", drawn.getvalue()[drawn.getvalue().index("<svg") :])


@dataclass(frozen=True, slots=True)
class Page:
    """A report: its answer in words, at most MOST_PICTURES pictures, and tables behind them that open on demand."""

    title: str
    answer: Mapping[str, str]  # sentences by their keys in HEADS; empty ones are left out
    pictures: Sequence[Picture]
    more: Mapping[str, str]  # HTML by its heading
    reload_s: int | None = None  # seconds after which a browser loads it again, where it changes

    def write(self, path: Path) -> Path:
        """Write the page; gives its path. Raises OSError, ConfigError without matplotlib."""
        path.write_text(self.to_html(), encoding="utf-8")
        return path

    def to_html(self) -> str:
        """The page as HTML, all words escaped but those of `more`."""
        assert len(self.pictures) <= MOST_PICTURES, "a page that shows everything shows nothing"
        again = "" if self.reload_s is None else f'<meta http-equiv="refresh" content="{self.reload_s}">'
        title, told = html.escape(self.title), [(HEADS[key], words) for key, words in self.answer.items() if words]
        answer = "".join(f"<dt>{name}</dt><dd>{html.escape(words)}</dd>" for name, words in told)
        more = "".join(f"<details><summary>{html.escape(a)}</summary>{b}</details>" for a, b in self.more.items() if b)
        pictures = "".join(picture.to_html(number) for number, picture in enumerate(self.pictures))
        return (
            f'<!doctype html><html lang="en"><meta charset="utf-8">{again}<title>{title}</title>'
            f'<meta name="viewport" content="width=device-width,initial-scale=1"><style>{STYLE}</style><h1>{title}</h1>'
            f'<dl>{answer}</dl><div class="pictures">{pictures}</div>{more}</html>\n'
        )


@contextmanager
def report_folder(folder: Path) -> Iterator[Path]:
    """A folder that is made for a report. Raises ConfigError where files cannot be written to it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield folder
    except OSError as error:
        raise ConfigError(f"{folder}: cannot write the report: {error}") from error


def html_table(rows: Iterable[Sequence[str]], head: Sequence[str] = ()) -> str:
    """Rows of text as an HTML table whose first column names them; one with a `head` scrolls if it is too wide."""
    body = "".join(
        f"<tr><th>{html.escape(name)}</th>{''.join(f'<td>{html.escape(cell)}</td>' for cell in cells)}</tr>"
        for name, *cells in rows
    )
    if not head:
        return f"<table>{body}</table>" if body else ""
    top = "".join(f"<th>{html.escape(cell)}</th>" for cell in head)
    return f'<div class="columns"><table><tr>{top}</tr>{body}</table></div>'


def listed(names: Sequence[str], most: int = 6) -> str:
    """Names with commas and an `and`; where there are more than `most`, the first of them and how many follow."""
    if len(names) > most:
        names = [*names[: most - 1], f"{len(names) - most + 1} more"]
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def table(head: list[str], rows: list[list[str]]) -> list[str]:
    """Lines of right-aligned columns under their headings."""
    widths = [max(len(row[i]) for row in [head, *rows]) for i in range(len(head))]
    return ["  ".join(cell.rjust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in [head, *rows]]


def require_matplotlib(wanted: str) -> None:
    """Raise ConfigError unless matplotlib is installed; `wanted` names what needs it, such as an option.

    Commands call this before their work begins, so that nobody waits for a picture that cannot be drawn.
    """
    try:
        missing = importlib.util.find_spec("matplotlib") is None
    except ValueError:  # colour-science puts a stand-in without a spec in its place where it is not installed
        missing = True
    if missing:
        raise ConfigError(f"{wanted} needs matplotlib: pip install 'airgs-codec[plot]'")


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of a size in inches, laid out so that no label is cut. Raises ConfigError without matplotlib."""
    require_matplotlib("a picture")
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def save_figure(figure: Figure, path: Path, dpi: int = 100) -> None:
    """Write a figure in the format that the ending of `path` names. Raises ConfigError."""
    known = figure.canvas.get_supported_filetypes()
    if path.suffix[1:].lower() not in known:
        raise ConfigError(f"{path}: expected a name that ends in .{', .'.join(sorted(known))}")
    try:
        figure.savefig(path, dpi=dpi)
    except OSError as error:
        raise ConfigError(f"{path}: cannot write the picture: {error.strerror or error}") from error


def plain_log_ticks(axis: Axis, most: int = 6) -> None:
    """Label a logarithmic axis with at most `most` plain numbers, when its limits are final.

    matplotlib labels minor ticks too where an axis spans less than a decade, one over the other.
    """
    from matplotlib.ticker import NullLocator

    low, high = sorted(axis.get_view_interval())
    axis.set_ticks(_log_ticks(low, high, most))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_locator(NullLocator())


def _log_ticks(low: float, high: float, most: int) -> list[float]:
    """At most `most` round numbers in [low, high], 0 < low < high, as many as fit."""
    from matplotlib.ticker import MaxNLocator

    if high < 4 * low:
        return [float(tick) for tick in MaxNLocator(most - 1).tick_values(low, high) if low <= tick <= high]
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for steps in ((1, 1.5, 2, 3, 4, 5, 6, 7, 8, 9), (1, 2, 5), (1, 3), (1,)):
        ticks = [step * 10.0**decade for decade in decades for step in steps if low <= step * 10.0**decade <= high]
        if len(ticks) <= most:
            return ticks
    return ticks[:: math.ceil(len(ticks) / most)]

"""What several reports share: tables of text, the frame of a page, and figures drawn with matplotlib.

matplotlib is an optional dependency (the extra `plot`) and half a second of imports: it is imported here alone, and
only when a figure is made.
"""

from __future__ import annotations

import html
import importlib.util
import math
from pathlib import Path
from typing import TYPE_CHECKING

from airgs_codec.errors import ConfigError

if TYPE_CHECKING:
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure


def table(head: list[str], rows: list[list[str]]) -> list[str]:
    """Lines of right-aligned columns under their headings."""
    widths = [max(len(row[i]) for row in [head, *rows]) for i in range(len(head))]
    return ["  ".join(cell.rjust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in [head, *rows]]


def page(title: str, body: str, width: str = "70rem", style: str = "", reload_s: int | None = None) -> str:
    """An HTML page of at most `width`; `style` is CSS beside what every page has.

    `reload_s`: seconds after which a browser loads it again, where it changes.
    """
    shared = (
        f"body{{font:15px/1.5 system-ui,sans-serif;max-width:{width};margin:2rem auto;padding:0 1rem;color:#222}}"
        "img{max-width:100%;margin-top:1rem}th{text-align:left;padding-right:2rem;font-weight:600}"
    )
    again = "" if reload_s is None else f'<meta http-equiv="refresh" content="{reload_s}">'
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8">{again}<title>{html.escape(title)}</title>'
        f"<style>{shared}{style}</style><h1>{html.escape(title)}</h1>{body}</html>\n"
    )


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
    try:
        figure.savefig(path, dpi=dpi)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: cannot write the picture: {error}") from error


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

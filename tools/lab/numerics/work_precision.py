"""Error against run time, of everything that trades one for the other.

Every panel is a value: the settings that were measured, how good they are in one unit, and what is good enough. Its
advice is computed: the best setting, the cheapest that is good enough, and the default.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from airgs_codec._report import plain_log_ticks
from airgs_codec._settings import setting
from airgs_codec.errors import ConfigError
from airgs_codec.render import cpu
from tools.lab.numerics.panels import NAMES, PARTS, Panel, Part
from tools.lab.numerics.rows import FOX, Bench, Row, open_scene, open_spinach, read_row
from tools.lab.options import expect_names
from tools.lab.page import Page, Picture, Section, Table, write_csv
from tools.lab.results import content

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from tools.lab.command import Lab

WIDTH, HEIGHT, ACROSS = 7.2, 3.7, 2  # inches of a panel of a picture, and how many of them stand side by side
FEW_TICKS = 5


@dataclass(frozen=True, slots=True)
class Options:
    """What is measured on what."""

    scene: str = setting(f"fox={FOX}", "NAME=FOLDER or NAME=FOLDER=VIEWS, the fox by default")
    spinach: Path | None = setting(None, "a clip with spinach_views.json beside it, in addition")
    only: tuple[str, ...] = setting(NAMES, f"some of {', '.join(NAMES)}")
    quick: bool = setting(False, "fewer points and runs")
    rows: Path | None = setting(None, "a CSV that an earlier run has written: measure nothing, make its page again")
    before: str = setting("", "a sentence on when and where those rows were measured")


def run(options: Options, lab: Lab) -> Page:
    """Measure what is missing. Raises AirgsError."""
    expect_names("--only", options.only, NAMES)
    if options.rows is not None:
        with options.rows.open(encoding="utf-8") as file:
            return page([read_row(fields) for fields in csv.DictReader(file)], options.before)
    scenes = [open_scene(options.scene)]
    if options.spinach is not None:
        scenes.append(open_spinach(options.spinach))
    bench = Bench(tuple(scenes), lab.folder, options.quick)
    torch.set_num_threads(1)
    code = content(Path(__file__).parent)
    rows: list[Row] = []
    with cpu.one_thread():
        for point in (point for part in PARTS if part.name in options.only for point in part.measure(bench)):
            reads = {**point.reads, "code": code, "scene": point.scene and point.scene.identity}
            rows += lab.results.once(point.name, reads, point.make)
    write_csv([asdict(row) for row in rows], lab.folder / "work_precision.csv")
    return page(rows)


def page(rows: Sequence[Row], before: str = "") -> Page:
    """The report of some rows."""
    if not rows:
        raise ConfigError("expected rows, got none")
    sections, judged = [], []
    for part in PARTS:
        some = [row for row in rows if row.section == part.name]
        if not some:
            continue
        words = []
        for panel in part.panels:
            found = judge(panel, of_panel(panel, some))
            judged += found
            words += advice(panel, found) + [panel.note] * bool(panel.note and of_panel(panel, some))
        words += stages_in_words(some)
        picture = Picture(part.picture, part.title, partial(draw, part, some), picture_size(part, some), grid=False)
        sections.append(Section("\n".join(f"- {line}" for line in words), part.title, [picture]))
    shown = [line.cells() for line in judged]
    table = Table("work_precision-advice", shown, {name: (name, "") for name in shown[0]} if shown else {})
    sections.append(Section("", "What is good enough", tables=[table]))
    return Page(sections, HOW, before=before)


HOW = (
    "What follows is the cheapest that is nearly as good as the best. Seconds are the CPU's; PSNR is from views that "
    "decided nothing. All rows: [work_precision.csv](work_precision.csv)."
)


def of_panel(panel: Panel, rows: Sequence[Row]) -> list[Row]:
    """The rows of a panel."""
    return [row for row in rows if row.panel == panel.name]


def by_scene(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """The rows of each scene, in their order."""
    return {scene: [row for row in rows if row.scene == scene] for scene in dict.fromkeys(row.scene for row in rows)}


@dataclass(frozen=True, slots=True)
class Judged:
    """What the points of a panel come to on one scene."""

    panel: Panel
    best: Row
    cheap: Row  # the cheapest that is as good as the best but for `enough`
    default: Row | None
    others: tuple[Row, ...]  # all that were judged

    def cells(self) -> dict[str, str]:
        """A row of the table."""
        unit = re.split(" PSNR| a | of | that | at ", self.panel.unit)[0]
        cells = {"question": f"{self.panel.question}, {unit}", "scene": self.cheap.scene}
        cells["good enough"] = f"{self.name(self.cheap)}: {figures(self.cheap)}"
        same = self.best == self.cheap
        return cells | {"best": "same" if same else f"{self.name(self.best)}: {figures(self.best)}"}

    def name(self, row: Row) -> str:
        """A point in words: its curve and its setting, where they tell it from others."""
        curves, settings = ({getattr(other, name) for other in self.others} for name in ("curve", "setting"))
        if len(settings) == 1:
            return row.curve
        return f"`{row.setting}`" if len(curves) == 1 or row.curve == row.setting else f"`{row.setting}` ({row.curve})"


def judge(panel: Panel, rows: Sequence[Row]) -> list[Judged]:
    """The verdict on each scene; none where there is nothing to choose from."""
    lines = []
    for some in by_scene(rows).values():
        judged = [row for row in some if row.setting not in panel.without and not math.isnan(row.error)]
        if panel.curves:
            judged = [row for row in judged if row.curve in panel.curves]
        if panel.last:
            judged = list({row.curve: row for row in judged}.values())
        if len(judged) < 2 or panel.enough is None:
            continue
        sign = -1 if panel.more else 1
        best = min(judged, key=lambda row: (sign * row.error, row.seconds))
        near = [row for row in judged if sign * (row.error - best.error) <= panel.enough]
        cheap = min(near, key=lambda row: row.seconds)
        default = next((row for row in judged if (row.curve, row.setting) == panel.default), None)
        lines.append(Judged(panel, best, cheap, default, tuple(judged)))
    return lines


def advice(panel: Panel, judged: Sequence[Judged]) -> list[str]:
    """Return what to take, and what the default is worth beside it; scenes of which the same is to be said together."""
    said: dict[str, list[str]] = {}
    for one in judged:
        said.setdefault(_worth(one), []).append(one.cheap.scene)
    return [f"{panel.question} ({', '.join(scenes)}): {words}." for words, scenes in said.items()]


def _worth(one: Judged) -> str:
    name, default = one.name(one.cheap), one.default
    if default is None:
        return f"take {name}"
    if default == one.cheap:
        return f"take {name}, the default"
    off = (one.cheap.error - default.error) * (1 if one.panel.more else -1)
    longer, unit = figure(default.seconds / one.cheap.seconds), one.panel.unit.split()[0]
    worth = f"{figure(abs(off))} {unit} {'worse' if off > 0 else 'better'}"
    return f"take {name}; {longer} times as long, the default, {one.name(default)}, is {worth}"


def stages_in_words(rows: Sequence[Row]) -> list[str]:
    """The stage of decoding that takes longest, for each scene."""
    words = []
    for scene, some in by_scene([row for row in rows if row.panel == "stages"]).items():
        whole, longest = sum(row.seconds for row in some), max(some, key=lambda row: row.seconds)
        share = 100 * longest.seconds / whole
        words.append(f"Stages ({scene}): {longest.curve} takes {share:.0f} % of {seconds(whole)} a frame.")
    return words


def figures(row: Row) -> str:
    """The error and the time of a point."""
    return f"{figure(row.error)}, {seconds(row.seconds)}"


def seconds(value: float) -> str:
    """A time with its unit."""
    if value >= 1:
        return f"{figure(value)} s"
    return f"{figure(1e3 * value)} ms" if value >= 1e-3 else f"{figure(1e6 * value)} µs"


def figure(value: float) -> str:
    """Three significant figures, without an exponent from 0.001 on."""
    if value == 0 or abs(value) >= 1e-3:
        return f"{float(f'{value:.3g}'):,g}"
    return f"{value:.1e}".replace("e-0", "e-")


def parts_of(part: Part, rows: Sequence[Row]) -> list[tuple[Panel, str, list[Row]]]:
    """A panel, its title and rows for every scene, or for all of them where each is a curve."""
    found = []
    for panel in part.panels:
        scenes = by_scene(of_panel(panel, rows))
        together = [row for some in scenes.values() for row in some]
        if len(scenes) < 2 or panel.name == "stages" or all(row.curve == row.scene for row in together):
            found += [(panel, panel.question, together)] * bool(together)
        else:
            found += [(panel, f"{panel.question} ({scene})", some) for scene, some in scenes.items()]
    return found


def picture_size(part: Part, rows: Sequence[Row]) -> tuple[float, float]:
    """Inches of the picture of a part."""
    count = len(parts_of(part, rows))
    return WIDTH * min(ACROSS, count), HEIGHT * -(-count // ACROSS)


def draw(part: Part, rows: Sequence[Row], figure: Figure) -> None:
    """Every panel of a part that has rows, those of several scenes side by side."""
    shown = parts_of(part, rows)
    across = min(ACROSS, len(shown))
    axes = figure.subplots(-(-len(shown) // across), across, squeeze=False).ravel()
    for axis, (panel, title, some) in zip(axes, shown, strict=False):
        (draw_bars if panel.name == "stages" else draw_curves)(axis, panel, some)
        axis.set_title(title, fontsize=11, loc="left")
        axis.set_xlabel(panel.time)
        axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
        axis.grid(alpha=0.25)
    for axis in axes[len(shown) :]:
        axis.set_axis_off()


def draw_curves(axis: Axes, panel: Panel, rows: list[Row]) -> None:
    """A curve with bars from quartile to quartile, its settings beside its points."""
    drawn = [row for row in rows if not math.isnan(row.error) and (row.error > 0 or not panel.log)]
    for curve in dict.fromkeys(row.curve for row in drawn):
        some = [row for row in drawn if row.curve == curve]
        x, y = [row.seconds for row in some], [row.error for row in some]
        across = [row.seconds - row.seconds_low for row in some], [row.seconds_high - row.seconds for row in some]
        up = [row.error - row.error_low for row in some], [row.error_high - row.error for row in some]
        bars = axis.errorbar(x, y, up, across, "o", markersize=4, elinewidth=0.7, label=curve)
        bars[0].set_linestyle("none" if curve in panel.loose else "-")
        for row in some:
            if panel.labels and row.setting != curve:
                axis.annotate(row.setting, (row.seconds, row.error), (4, 4), textcoords="offset points", fontsize=7.5)
    axis.set_xscale("log")
    axis.margins(0.12)
    plain_log_ticks(axis.xaxis, FEW_TICKS)
    if panel.log:
        axis.set_yscale("log")
        plain_log_ticks(axis.yaxis, FEW_TICKS)
    axis.set_ylabel(panel.unit)


def draw_bars(axis: Axes, panel: Panel, rows: list[Row]) -> None:
    """A bar for each scene, stage after stage."""
    left = dict.fromkeys((row.scene for row in rows), 0.0)
    for curve in dict.fromkeys(row.curve for row in rows):
        some = [row for row in rows if row.curve == curve]
        axis.barh([r.scene for r in some], [r.seconds for r in some], left=[left[r.scene] for r in some], label=curve)
        for row in some:
            left[row.scene] += row.seconds
    axis.set_ylim(len(left) - 0.2, -0.8)  # from the top down

"""Error against run time: a question for each part that trades one for the other, with what is known of its settings.

A question is a value: the settings that were measured, and how good they are in one unit. Each setting stands beside
the default, in pairs over links, pictures or seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from airgs_codec.errors import ConfigError
from airgs_codec.play.policies import DEFAULT_POLICY, HORIZON_SEGMENTS
from airgs_codec.play.trace import read_trace
from airgs_codec.render import cpu
from airgs_codec.scene.sequence import open_sequence
from tools.lab import Lab, Page, PagePicture, Section, Table, content, plain_log_ticks, rows_of, setting
from tools.lab.numerics import decode, encode, renderer, selector, survey, trainer
from tools.lab.numerics.rows import FOX, FOX_FPS, REPEATS, Bench, Point, Row, Scene, open_spinach
from tools.lab.paired import difference

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True)
class Question:
    name: str  # in rows, and of its picture
    text: str
    measure: Callable[[Bench], Iterator[Point]]
    unit: str  # of error; its first word is that of a difference
    time: str  # what the seconds are of
    default: tuple[str, str] = ("", "")  # curve and setting; nothing: it is not among those measured
    more: bool = False  # whether more of the unit is better
    log: bool = False  # axis of error
    last: bool = False  # only the last setting of each curve is judged: the others are other tasks
    labels: bool = True  # settings stand beside their points


CPU = "CPU seconds"
QUESTIONS = (
    Question(
        "encode", "What does time buy in an encode?", encode.measure, encode.UNIT, CPU, (encode.CALIBRATED, "veryslow")
    ),
    Question(
        "claims", "How many pictures does a claim need?", survey.measure, survey.OFF, CPU, log=True, labels=False,
    ),
    Question(
        "decode", "What does a cheaper rung save in decoding?", decode.measure, decode.UNIT, f"{CPU} a frame",
        (decode.RUNGS, "L0"), more=True,
    ),
    Question(
        "renderer", "Is a picture in float32 good enough?", renderer.measure, renderer.UNIT, f"{CPU} a picture",
        (renderer.SHIPPED, "320 x 320"), log=True, last=True, labels=False,
    ),
    Question(
        "trainer", "How many iterations does a frame need?", trainer.measure, trainer.UNIT, CPU, ("direct", "300"),
        more=True,
    ),
    Question(
        "horizon", "How many segments ahead should a plan look?", selector.horizons, selector.UNIT, f"{CPU} a choice",
        ("horizon", str(HORIZON_SEGMENTS)), more=True,
    ),
    Question(
        "policies", "Which policy should choose?", selector.policies, selector.UNIT, f"{CPU} a choice",
        ("policies", DEFAULT_POLICY), more=True,
    ),
)  # fmt: skip
NAMES = tuple(question.name for question in QUESTIONS)


WIDTH, HEIGHT = 6.0, 3.7  # inches of a scene's axes
FEW_TICKS = 5
COLUMNS = {
    "question": ("question", ""), "scene": ("scene", ""), "setting": ("setting", ""), "curve": ("of", ""),
    "beside": ("beside", ""), "time": ("share of its time", ".2g"), "gain": ("gains", "+.3g"),
    "gain_from": ("95 %, from", "+.3g"), "gain_to": ("to", "+.3g"), "unit": ("in", ""),
}  # fmt: skip
HOW = (
    "Settings are compared with the default in pairs, over links, pictures or seeds: a difference counts where its "
    "95 % interval leaves zero out (bootstrap), with at least six pairs. Seconds are the CPU's, medians of "
    f"{REPEATS} runs ({encode.REPEATS} encodes); bars reach from quartile to quartile, or one standard error of QoE."
)


@dataclass(frozen=True, slots=True)
class Options:
    fox: Path = setting(FOX, "a sequence with its cameras")
    spinach: Path | None = setting(None, "a clip with spinach_views.json beside it, in addition")
    traces: tuple[Path, ...] = setting((), "folders of traces for sessions, in place of made ones")
    only: tuple[str, ...] = setting(NAMES, "parts", choices=NAMES)
    quick: bool = setting(False, "fewer points and runs")


def run(options: Options, lab: Lab) -> Page:
    scenes = [Scene("fox", open_sequence(options.fox, fps=FOX_FPS))]
    if options.spinach is not None:
        scenes.append(open_spinach(options.spinach))
    traces = tuple(read_trace(path) for folder in options.traces for path in sorted(folder.iterdir()))
    bench = Bench(tuple(scenes), lab.folder, traces, options.quick)
    torch.set_num_threads(1)
    code = content(Path(__file__).parent)
    rows: list[Row] = []
    with cpu.one_thread():
        for point in (point for one in QUESTIONS if one.name in options.only for point in one.measure(bench)):
            reads = {**point.reads, "code": code, "scene": point.scene and point.scene.identity}
            rows += lab.results.once(point.name, reads, point.make)
    return page(rows)


def page(rows: Sequence[Row]) -> Page:
    if not rows:
        raise ConfigError("expected rows, got none")
    sections, compared = [], list[dict[str, Any]]()
    for question in QUESTIONS:
        some = [row for row in rows if row.question == question.name]
        if some:
            size = WIDTH * len(by_scene(some)), HEIGHT
            picture = PagePicture(f"precision-{question.name}", question.text, partial(draw, question, some), size)
            sections.append(Section("", question.text, [picture]))
            compared += [] if question.default == ("", "") else beside(question, some)
    plain = [{name: value for name, value in row.items() if name != "samples"} for row in rows_of(rows)]
    return Page(sections, HOW, data=[Table("work_precision", plain), Table("work_precision-beside", compared, COLUMNS)])


def by_scene(rows: Sequence[Row]) -> dict[str, list[Row]]:
    return {scene: [row for row in rows if row.scene == scene] for scene in dict.fromkeys(row.scene for row in rows)}


def beside(question: Question, rows: Sequence[Row]) -> Iterator[dict[str, Any]]:
    """Each setting beside the default of its scene: its share of the time, and what it gains."""
    for scene, some in by_scene(rows).items():
        judged = list({row.curve: row for row in some}.values()) if question.last else some
        named = [row for row in judged if (row.curve, row.setting) == question.default]
        base = (named or [row for row in judged if row.curve == question.default[0]] or judged)[-1]
        sign = 1 if question.more else -1
        for row in judged:
            known: dict[str, Any] = {"question": question.name, "scene": scene, "curve": row.curve}
            known |= {"setting": row.setting, "beside": base.setting, "time": row.seconds / base.seconds}
            mine, other = ([sign * value for value in one.samples] for one in (row, base))
            found = difference(mine, other) if len(row.samples) > 1 else None  # measured once: nobody knows
            known |= {"gain": sign * (row.error - base.error), "gain_from": found and found.low}
            yield known | {"gain_to": found and found.high, "sign": found and found.sign, "unit": question.unit}


def draw(question: Question, rows: Sequence[Row], figure: Figure) -> None:
    scenes = by_scene(rows)
    axes = figure.subplots(1, len(scenes), squeeze=False).ravel()
    for axis, (scene, some) in zip(axes, scenes.items(), strict=True):
        draw_curves(axis, question, some)
        axis.set_title(scene, fontsize=11, loc="left")
        axis.set_xlabel(question.time)
        if len({row.curve for row in some}) > 1:
            axis.legend(fontsize=8)


def draw_curves(axis: Axes, question: Question, rows: list[Row]) -> None:
    drawn = [row for row in rows if row.error > 0 or not question.log]
    for curve in dict.fromkeys(row.curve for row in drawn):
        some = [row for row in drawn if row.curve == curve]
        x, y = [row.seconds for row in some], [row.error for row in some]
        across = [row.seconds - row.seconds_low for row in some], [row.seconds_high - row.seconds for row in some]
        up = [row.error - row.error_low for row in some], [row.error_high - row.error for row in some]
        axis.errorbar(x, y, up, across, "o", markersize=4, elinewidth=0.7, label=curve)
        for row in some:
            words = ", ".join(filter(None, [row.setting if row.setting != curve else "", row.note]))
            if question.labels and words:
                at = row.seconds, row.error
                axis.annotate(words, at, (4, 3), textcoords="offset points", fontsize=7.5)
    axis.set_xscale("log")
    axis.margins(0.22 if question.labels else 0.12, 0.12)
    plain_log_ticks(axis.xaxis, FEW_TICKS)
    if question.log:
        axis.set_yscale("log")
        plain_log_ticks(axis.yaxis, FEW_TICKS)
    axis.set_ylabel(question.unit)

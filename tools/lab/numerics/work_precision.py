"""Error against run time: a question for each part that trades one for the other, with the setting to take.

A question is a value: the settings that were measured, how good they are in one unit, and what is good enough. Its
answer is computed: the cheapest setting that is nearly as good as the best, what less and more time would give, and
what the default is worth beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from airgs_codec.errors import ConfigError
from airgs_codec.play.policies import DEFAULT_POLICY, HORIZON_SEGMENTS, ORACLES
from airgs_codec.play.trace import read_trace
from airgs_codec.render import cpu
from airgs_codec.scene.sequence import open_sequence
from tools.lab import Lab, Page, PagePicture, Section, Table, content, plain_log_ticks, rows_of, setting
from tools.lab.numerics import decode, encode, renderer, selector, survey, trainer
from tools.lab.numerics.rows import FOX, FOX_FPS, REPEATS, Bench, Point, Row, Scene, open_spinach

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
    enough: float  # as near to the best as this is good enough, in the unit
    default: tuple[str, str] = ("", "")  # curve and setting; nothing: it is not among those measured
    more: bool = False  # whether more of the unit is better
    log: bool = False  # axis of error
    last: bool = False  # only the last setting of each curve is judged: the others are other tasks
    without: tuple[str, ...] = ()  # settings that nobody can choose
    labels: bool = True  # settings stand beside their points
    why: str = ""  # the default may be another than the answer


CPU = "CPU seconds"
QUESTIONS = (
    Question(
        "encode", "What does time buy in an encode?", encode.measure, encode.UNIT, CPU, 0.3,
        default=(encode.CALIBRATED, "veryslow"),
    ),
    Question(
        "claims", "How many pictures does a claim need?", survey.measure, survey.OFF, CPU, 0.1,
        log=True, labels=False,
    ),
    Question(
        "decode", "What does a cheaper rung save in decoding?", decode.measure, decode.UNIT, f"{CPU} a frame", 0.5,
        default=(decode.RUNGS, "L0"), more=True,
    ),
    Question(
        "renderer", "Is a picture in float32 good enough?", renderer.measure, renderer.UNIT, f"{CPU} a picture", 1e-3,
        default=(renderer.SHIPPED, "320 x 320"), log=True, last=True, labels=False,
    ),
    Question(
        "trainer", "How many iterations does a frame need?", trainer.measure, trainer.UNIT, CPU, 0.1,
        default=("direct", "300"), more=True,
    ),
    Question(
        "horizon", "How many segments ahead should a plan look?", selector.horizons, selector.UNIT, f"{CPU} a choice",
        0.1, default=("horizon", str(HORIZON_SEGMENTS)), more=True,
        why="it waits least, which QoE counts for little",
    ),
    Question(
        "policies", "Which policy should choose?", selector.policies, selector.UNIT, f"{CPU} a choice", 0.1,
        default=("policies", DEFAULT_POLICY), more=True, without=tuple(ORACLES),
    ),
)  # fmt: skip
NAMES = tuple(question.name for question in QUESTIONS)


WIDTH, HEIGHT = 6.0, 3.7  # inches of a scene's axes
FEW_TICKS = 5
HOW = (
    f"The setting to take is the cheapest that is nearly as good as the best. Seconds are the CPU's, medians of "
    f"{REPEATS} runs; bars reach from quartile to quartile. PSNR is from views that decided nothing; QoE is the mean "
    "over links, with its standard error."
)


@dataclass(frozen=True, slots=True)
class Options:
    fox: Path = setting(FOX, "a sequence with its cameras")
    spinach: Path | None = setting(None, "a clip with spinach_views.json beside it, in addition")
    traces: Path | None = setting(None, "a folder of traces for sessions, in place of made ones")
    only: tuple[str, ...] = setting(NAMES, "parts", choices=NAMES)
    quick: bool = setting(False, "fewer points and runs")


def run(options: Options, lab: Lab) -> Page:
    scenes = [Scene("fox", open_sequence(options.fox, fps=FOX_FPS))]
    if options.spinach is not None:
        scenes.append(open_spinach(options.spinach))
    traces = tuple(map(read_trace, sorted(options.traces.iterdir()))) if options.traces is not None else ()
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
    sections = []
    for question in QUESTIONS:
        some = [row for row in rows if row.question == question.name]
        if some:
            size = WIDTH * len(by_scene(some)), HEIGHT
            picture = PagePicture(f"precision-{question.name}", question.text, partial(draw, question, some), size)
            sections.append(Section(answer(question, some), question.text, [picture]))
    return Page(sections, HOW, data=[Table("work_precision", rows_of(rows))])


def by_scene(rows: Sequence[Row]) -> dict[str, list[Row]]:
    return {scene: [row for row in rows if row.scene == scene] for scene in dict.fromkeys(row.scene for row in rows)}


def answer(question: Question, rows: Sequence[Row]) -> str:
    """The setting to take in each scene, and what the default is worth beside it where it is another."""
    words = []
    for scene, some in by_scene(rows).items():
        judged = [row for row in some if row.setting not in question.without]
        if question.last:
            judged = list({row.curve: row for row in judged}.values())
        if len(judged) < 2:
            continue  # nothing to choose from
        sign = 1 if question.more else -1
        best = max(judged, key=lambda row: sign * row.error)
        near = [row for row in judged if sign * (best.error - row.error) <= question.enough]
        take = min(near, key=lambda row: row.seconds)
        name = f"`{take.setting}` ({take.curve})"
        words.append(f"{scene}: take {name}, {figure(take.error)} {question.unit} in {seconds(take.seconds)}")
        for row in (row for row in judged if (row.curve, row.setting) == question.default and row != take):
            gain, times = sign * (row.error - take.error), figure(row.seconds / take.seconds)
            worth = f"{figure(abs(gain))} {question.unit.split()[0]} {'better' if gain > 0 else 'worse'}"
            words[-1] += f"; the default, `{row.setting}`, is {worth} in {times} times the time"
            words[-1] += f": {question.why}" if question.why else ""
    return f"{'. '.join(words)}." if words else ""


def seconds(value: float) -> str:
    if value >= 1:
        return f"{figure(value)} s"
    return f"{figure(1e3 * value)} ms" if value >= 1e-3 else f"{figure(1e6 * value)} µs"


def figure(value: float) -> str:
    if value == 0 or abs(value) >= 1e-3:
        return f"{float(f'{value:.3g}'):,g}"
    return f"{value:.1e}".replace("e-0", "e-")


def draw(question: Question, rows: Sequence[Row], figure: Figure) -> None:
    scenes = by_scene(rows)
    axes = figure.subplots(1, len(scenes), squeeze=False).ravel()
    for axis, (scene, some) in zip(axes, scenes.items(), strict=True):
        draw_curves(axis, question, some)
        axis.set_title(scene, fontsize=11, loc="left")
        axis.set_xlabel(question.time)
        if len({row.curve for row in some}) > 1:
            axis.legend(loc="upper right", fontsize=8)


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

"""Error against run time: a question for each part that trades one for the other, with what is known of its settings.

A question is a value: the settings that were measured, and how good they are in one unit. Its answer is computed, in
pairs with the default over links, pictures or seeds: what is better beyond its error, what is cheaper without a
difference, or what the next cheaper one costs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from airgs_codec.errors import ConfigError
from airgs_codec.play.policies import DEFAULT_POLICY, HORIZON_SEGMENTS
from airgs_codec.play.study import SURE_TRACES
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
    says: Callable[[str, list[Row]], str] | None = None  # its own answer of a scene


CPU = "CPU seconds"
QUESTIONS = (
    Question(
        "encode", "What does time buy in an encode?", encode.measure, encode.UNIT, CPU, (encode.CALIBRATED, "veryslow")
    ),
    Question(
        "claims", "How many pictures does a claim need?", survey.measure, survey.OFF, CPU, log=True, labels=False,
        says=survey.answer,
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
    sections = []
    for question in QUESTIONS:
        some = [row for row in rows if row.question == question.name]
        if some:
            size = WIDTH * len(by_scene(some)), HEIGHT
            picture = PagePicture(f"precision-{question.name}", question.text, partial(draw, question, some), size)
            sections.append(Section(answer(question, some), question.text, [picture]))
    return Page(
        sections,
        HOW,
        data=[Table("work_precision", [{k: v for k, v in row.items() if k != "samples"} for row in rows_of(rows)])],
    )


def by_scene(rows: Sequence[Row]) -> dict[str, list[Row]]:
    return {scene: [row for row in rows if row.scene == scene] for scene in dict.fromkeys(row.scene for row in rows)}


def answer(question: Question, rows: Sequence[Row]) -> str:
    """Beside the default of each scene: what is better beyond its error, else what is as good, else the next one."""
    words = []
    for scene, some in by_scene(rows).items():
        if question.says:
            words.append(question.says(scene, some))
            continue
        judged = list({row.curve: row for row in some}.values()) if question.last else some
        named = [row for row in judged if (row.curve, row.setting) == question.default]
        base = (named or [row for row in judged if row.curve == question.default[0]] or judged)[-1]
        sign, unit = 1 if question.more else -1, question.unit.split()[0]
        pairs = {row: [sign * value for value in row.samples] for row in judged}
        beside = {row: difference(pairs[row], pairs[base]) for row in judged}
        better = [row for row in judged if beside[row].sign > 0]
        cheaper = [row for row in judged if row.seconds < base.seconds]
        same = [row for row in cheaper if not beside[row].sign and len(base.samples) >= SURE_TRACES]
        note = f", {base.note}" if base.note else ""
        of = f"{scene}: {named_as(base)}, {figure(base.error)} {question.unit} in {seconds(base.seconds)}{note}"
        if better or same or cheaper:
            row = max(better or cheaper, key=lambda row: sign * row.error)
            row = row if better or not same else min(same, key=lambda row: row.seconds)
            found = beside[row].words(unit)
            if len(base.samples) < SURE_TRACES:
                found = f"{figure(row.error)} {unit}, measured once"
            of += f"; {named_as(row)}, in {figure(row.seconds / base.seconds)} of the time: {found}"
        words.append(of)
    return f"{'. '.join(words)}." if words else ""


def named_as(row: Row) -> str:
    return f"`{row.setting}` ({row.curve})" if row.setting != row.curve else row.curve


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

"""Rate and distortion of airgs beside published layouts and formats, over the same rows, views and frames.

PSNR is measured against renderings of the input, pooled over the test cameras and `--frames` frames of the sequence;
where transforms.json names pictures of these cameras and frames, PSNR against them stands beside it. The re-implemented
layouts (tools/lab/rd/layouts.py) run at the preset of x264 and x265 that airgs uses, veryslow, and as their published
scripts call these; V^3's in both forms that it publishes, whose better one at each rate is "better form". The other
coders are given all rows, in Morton order; "airgs, keeps all" drops none. BD-rate spans only the PSNR that both curves
cover; negative is smaller. Points that were measured stay measured.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from airgs_codec._report import plain_log_ticks
from airgs_codec.errors import ConfigError
from airgs_codec.render import read_cameras
from airgs_codec.scene.beside import exact_number
from airgs_codec.scene.sequence import open_sequence
from tools.lab import Lab, Page, Picture, Section, Table, required, rows_of, setting
from tools.lab.page import Row
from tools.lab.rd.coders import OURS, PRESETS, layout_trials, our_trials, v3_name
from tools.lab.rd.fourdgs import fourdgs_trials
from tools.lab.rd.layouts import V3_FORMS
from tools.lab.rd.points import RdPoint, bd_rate, best_of, curves, kb_at
from tools.lab.rd.programs import splat4d_trials, splat_transform_trials
from tools.lab.rd.subject import Subject, Trial, open_subject, pooled_psnr
from tools.lab.rd.written import written_trials

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COUNTED = (
    "Bytes are everything a viewer fetches for the sequence, divided by its frames: of airgs the whole top rung with "
    "both manifests, tables and sidecars; of the layouts every packet, parameter set and range; of the other "
    "formats their files."
)
BETTER = "better form"
STYLES = {"published": ":", "veryslow": "-", "keeps all": "--"}  # by the last words of a coder's name
ENDS_COLUMNS = {
    "coder": ("coder", ""), "small_kb": ("smallest point, kB a frame", ".1f"), "small_psnr": ("dB", ".1f"),
    "large_kb": ("largest point, kB a frame", ".1f"), "large_psnr": ("dB", ".1f"),
    "rate": ("rate of airgs to its", "+.0%"), "at_kb": ("kB a frame there", ".1f"), "share": ("airgs takes", ".0%"),
}  # fmt: skip
POINT_COLUMNS = {
    "coder": ("coder", ""), "setting": ("setting", ""), "kb_per_frame": ("kB a frame", ".2f"),
    "psnr": ("PSNR, dB", ".2f"), "ours_kb": ("airgs at that PSNR, kB", ".2f"),
    "truth_psnr": ("to pictures", ".2f"), "encode_s": ("encode, s", ".2f"), "decode_s": ("decode, s", ".2f"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Options:
    """What is coded, and by what."""

    sequence: Path = required("a sequence")
    views: Path = required("its cameras, of which the held-out ones measure")
    fps: str = setting("", "frames a second, where the sequence does not say")
    frames: int = setting(6, "frames measured")
    targets: tuple[float, ...] = setting((47.0, 45.5, 44.0, 42.5, 41.0, 39.5), "PSNR of our packages, dB")
    low: float = setting(41.0, "dB from which the BD-rate counts")
    high: float = setting(46.0, "dB up to which")
    at: float = setting(43.0, "dB at which bytes are compared")
    splat_transform: str = setting("", "a command such as 'splat-transform -g cpu'")
    splat4d: str = setting("", "the program of the PyPI package splats4d")
    fourdgs: str = setting("", "python of an environment with the PyPI package fourdgs")


def run(options: Options, lab: Lab) -> Page:
    """Every coder at every setting."""
    fps = exact_number(options.fps) if options.fps else None
    sequence = open_sequence(options.sequence, views=options.views, fps=fps)
    cameras = [c for c in read_cameras(options.views) if c.held_out]
    subject = open_subject(sequence, cameras, options.frames, options.views)
    points = list(measure(subject, trials(options), lab))
    better = [point for preset in PRESETS for point in _better_form(points, preset)]
    name = options.sequence.resolve().name
    title = f"{name}: {len(sequence)} frames"
    picture = Picture(f"rd-{name}", title, partial(draw, points, title), (9, 5.5))
    answer = (
        f"The rate compares from {options.low:g} to {options.high:g} dB, negative is smaller; the last columns are at "
        f"{options.at:g} dB."
    )
    if subject.truth:
        answer += f" The input itself is {pooled_psnr(subject.references, subject.truth):.2f} dB from pictures of it."
    tables = [
        Table(f"rd-{name}-ends", ends([*points, *better], options), ENDS_COLUMNS),
        Table(f"rd-{name}", _with_ours(points), POINT_COLUMNS),
        Table(f"rd-{name}-better-form", _with_ours(better, points), POINT_COLUMNS),
    ]
    return Page([Section(answer, pictures=[picture], tables=tables)], COUNTED)


def trials(options: Options) -> Iterator[Trial]:
    """Everything that is asked for, ours first."""
    yield from our_trials(options.targets, keep_all=False)
    yield from our_trials(options.targets, keep_all=True)
    yield from layout_trials()
    yield from written_trials()
    if options.splat4d:
        yield from splat4d_trials(options.splat4d)
    if options.fourdgs:
        yield from fourdgs_trials(options.fourdgs)
    if options.splat_transform:
        yield from splat_transform_trials(options.splat_transform)


def measure(subject: Subject, wanted: Iterator[Trial], lab: Lab) -> Iterator[RdPoint]:
    """Every trial that could be met; of the others it is told why not."""
    given = [[frames[0].means for _, frames in subject.groups], subject.measured, subject.references[0]]
    for trial in wanted:
        try:
            point = lab.results.once("rd", [trial.coder, trial.setting, given], lambda one=trial: subject.point(one))  # type: ignore[misc]
        except ConfigError as error:
            lab.tell(f"{trial.coder}, {trial.setting}: {error}")
            continue
        lab.tell(f"{point.coder}, {point.setting}: {point.kb_per_frame:.2f} kB a frame, {point.psnr:.2f} dB")
        yield point


def _better_form(points: Sequence[RdPoint], preset: str) -> list[RdPoint]:
    """V^3's layout in the form that is better at each rate."""
    return best_of(points, {v3_name(form, preset): form for form in V3_FORMS}, v3_name(BETTER, preset))


def _with_ours(points: Sequence[RdPoint], among: Sequence[RdPoint] | None = None) -> list[Row]:
    """A row for each point, with the kB a frame that `airgs`, `among` the points, takes at its PSNR."""
    ours = curves(points if among is None else among).get(OURS, [])
    return [row | {"ours_kb": kb_at(ours, p.psnr)} for row, p in zip(rows_of(points), points, strict=True)]


def ends(points: Sequence[RdPoint], options: Options) -> list[Row]:
    """A row for each coder: the ends of its curve, and how much smaller or larger `airgs` is at equal PSNR."""
    ours = curves(points).get(OURS, [])
    our_kb = kb_at(ours, options.at)
    at = {name: kb_at(curve, options.at) for name, curve in curves(points).items()}
    for preset in PRESETS:  # between points of both forms is none of either
        at[v3_name(BETTER, preset)] = min(
            (kb for form in V3_FORMS if (kb := at.get(v3_name(form, preset)))), default=None
        )
    rows: list[Row] = []
    for name, curve in curves(points).items():
        their_kb = at[name]
        rows.append({
            "coder": name, "small_kb": curve[0].kb_per_frame, "small_psnr": curve[0].psnr,
            "large_kb": curve[-1].kb_per_frame, "large_psnr": curve[-1].psnr,
            "rate": bd_rate(ours, curve, options.low, options.high) if name != OURS else None,
            "at_kb": their_kb, "share": our_kb / their_kb if our_kb and their_kb and name != OURS else None,
        })  # fmt: skip
    return rows


def draw(points: Sequence[RdPoint], title: str, figure: Figure) -> None:
    """Bytes against PSNR: a curve for each coder, in one colour for all curves of the same layout."""
    axis = figure.subplots()
    family = {p.coder: p.coder.removesuffix(f", {p.coder.split(', ')[-1]}") for p in points}
    family |= {coder: coder for coder in family if not coder.endswith(tuple(STYLES))}
    colours = {name: f"C{i}" for i, name in enumerate(dict.fromkeys(family.values()))}
    for coder, curve in curves(points).items():
        style = next((line for words, line in STYLES.items() if coder.endswith(words)), "-")
        x, y = [p.kb_per_frame for p in curve], [p.psnr for p in curve]
        axis.plot(
            x,
            y,
            f"o{style}",
            color=colours[family[coder]],
            label=coder,
            linewidth=2.5 if coder == OURS else 1.3,
            markersize=4,
        )
    axis.set(xlabel="kB a frame, everything fetched", ylabel="PSNR, dB (against renderings of the input)", title=title)
    axis.set_xscale("log")
    sizes = [p.kb_per_frame for p in points]
    axis.set_xlim(0.85 * min(sizes), 1.15 * max(sizes))
    plain_log_ticks(axis.xaxis, most=8)
    axis.legend()

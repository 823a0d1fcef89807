"""Rate and distortion of airgs beside published layouts and formats, over the same rows, views and frames.

PSNR is measured against renderings of the input, pooled over the test cameras and `--frames` frames of the sequence;
where transforms.json names pictures of these cameras and frames, PSNR against them stands beside it. The re-implemented
layouts (tools/lab/rd/layouts.py) run at the preset of x264 and x265 that airgs uses, veryslow, and at medium. The other
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
from tools.lab.rd.coders import OURS, layout_trials, our_trials
from tools.lab.rd.points import RdPoint, bd_rate, curves
from tools.lab.rd.programs import fourdgs_trials, splat4d_trials, splat_transform_trials
from tools.lab.rd.subject import Subject, Trial, open_subject, pooled_psnr

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COUNTED = (
    "Bytes are everything a viewer fetches for the sequence, divided by its frames: of airgs the whole top rung with "
    "both manifests, tables and sidecars; of the layouts every packet, parameter set and range; of the other "
    "formats their files."
)
STYLES = {"medium": ":", "veryslow": "-", "keeps all": "--"}  # by the last words of a coder's name
ENDS_COLUMNS = {
    "coder": ("coder", ""), "small_kb": ("smallest point, kB a frame", ".1f"), "small_psnr": ("dB", ".1f"),
    "large_kb": ("largest point, kB a frame", ".1f"), "large_psnr": ("dB", ".1f"),
    "rate": ("rate of airgs to its", "+.0%"),
}  # fmt: skip
POINT_COLUMNS = {
    "coder": ("coder", ""), "setting": ("setting", ""), "kb_per_frame": ("kB a frame", ".2f"),
    "psnr": ("PSNR, dB", ".2f"),
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
    name = options.sequence.resolve().name
    title = f"{name}: {len(sequence)} frames"
    picture = Picture(f"rd-{name}", title, partial(draw, points, title), (9, 5.5))
    answer = f"The last column compares from {options.low:g} to {options.high:g} dB; negative is smaller."
    if subject.truth:
        answer += f" The input itself is {pooled_psnr(subject.references, subject.truth):.2f} dB from pictures of it."
    tables = [
        Table(f"rd-{name}-ends", ends(points, options.low, options.high), ENDS_COLUMNS),
        Table(f"rd-{name}", rows_of(points), POINT_COLUMNS),
    ]
    return Page([Section(answer, pictures=[picture], tables=tables)], COUNTED)


def trials(options: Options) -> Iterator[Trial]:
    """Everything that is asked for, ours first."""
    yield from our_trials(options.targets, keep_all=False)
    yield from our_trials(options.targets, keep_all=True)
    yield from layout_trials()
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


def ends(points: Sequence[RdPoint], low: float, high: float) -> list[Row]:
    """A row for each coder: the ends of its curve, and how much smaller or larger `airgs` is at equal PSNR."""
    ours = curves(points).get(OURS, [])
    return [
        {
            "coder": name, "small_kb": curve[0].kb_per_frame, "small_psnr": curve[0].psnr,
            "large_kb": curve[-1].kb_per_frame, "large_psnr": curve[-1].psnr,
            "rate": bd_rate(ours, curve, low, high) if name != OURS else None,
        }
        for name, curve in curves(points).items()
    ]  # fmt: skip


def draw(points: Sequence[RdPoint], title: str, figure: Figure) -> None:
    """Bytes against PSNR: a curve for each coder, in one colour for all curves of the same layout."""
    axis = figure.subplots()
    families = list(dict.fromkeys(p.coder.split(",")[0] for p in points))
    for coder, curve in curves(points).items():
        style = next((line for words, line in STYLES.items() if coder.endswith(words)), "-")
        colour = f"C{families.index(coder.split(',')[0])}"
        x, y = [p.kb_per_frame for p in curve], [p.psnr for p in curve]
        axis.plot(x, y, f"o{style}", color=colour, label=coder, linewidth=2.5 if coder == OURS else 1.3, markersize=4)
    axis.set(xlabel="kB a frame, everything fetched", ylabel="PSNR, dB (against renderings of the input)", title=title)
    axis.set_xscale("log")
    sizes = [p.kb_per_frame for p in points]
    axis.set_xlim(0.85 * min(sizes), 1.15 * max(sizes))
    plain_log_ticks(axis.xaxis, most=8)
    axis.legend()

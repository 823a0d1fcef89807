"""Rate and distortion of airgs beside published layouts and formats, over the same rows, views and frames.

PSNR is measured against renderings of the input, pooled over the test cameras and `--frames` frames of the sequence;
where transforms.json names pictures of these cameras and frames, PSNR against them stands beside it. The re-implemented
layouts (tools/lab/rd/layouts.py) run at the preset of x264 and x265 that airgs uses, veryslow, and at medium. The other
coders are given all rows, in Morton order; "airgs, keeps all" drops none. BD-rate spans only the PSNR that both curves
cover; negative is smaller. Points that were measured stay measured.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from airgs_codec.errors import ConfigError
from airgs_codec.render import read_cameras
from airgs_codec.scene.sequence import open_sequence
from airgs_codec.scene.sequence_json import exact_number
from tools.lab import Lab, Page, Picture, Section, Table, required, rows_of, setting
from tools.lab.rd.coders import layout_trials, our_trials
from tools.lab.rd.points import RdPoint
from tools.lab.rd.programs import fourdgs_trials, splat4d_trials, splat_transform_trials
from tools.lab.rd.report import ENDS_COLUMNS, POINT_COLUMNS, draw, ends
from tools.lab.rd.subject import Subject, Trial, open_subject, pooled_psnr

COUNTED = (
    "Bytes are everything a viewer fetches for the sequence, divided by its frames: of airgs the whole top rung with "
    "both manifests, tables and sidecars; of the layouts every packet, parameter set and range; of the other "
    "formats their files."
)


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

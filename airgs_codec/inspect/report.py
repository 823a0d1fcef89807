"""The page of an encode: how near the package is to the frames that were given, and what each second bought."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec._report import GREY, Page, Picture, html_table, report_folder
from airgs_codec.encoder.measure import uncertainty_db
from airgs_codec.encoder.publish import EncodeReport, Stage, certainty_words
from airgs_codec.encoder.search import DELTA_E
from airgs_codec.inspect.compare import Comparison, Seen, compare_two, side_by_side
from airgs_codec.inspect.plot import plot_rungs
from airgs_codec.inspect.sides import Side, before_both, shared_views, side_of
from airgs_codec.inspect.summary import RungSummary, summarise
from airgs_codec.media.image import to_bytes, write_png
from airgs_codec.media.movie import write_movie
from airgs_codec.package.package import Package
from airgs_codec.package.region import first_views
from airgs_codec.play.report import beaten_words
from airgs_codec.progress import Progress, silent
from airgs_codec.render import Camera
from airgs_codec.render.compare import draw_frames, in_order
from airgs_codec.scene.camera import resized
from airgs_codec.scene.sequence import GaussianSequence

VIEWS = 4  # of each frame
PIXELS = 200_000  # of a picture, at most
FILM_NAME = "film.mp4"
LITTLE = 0.05  # share of the time under which a stage is not worth a word
MUCH = 0.4  # share of the time above which less of a stage may do
UNEVEN_DB = 3.0  # under the mean from which a frame is told of as a fault
DOUBT_DB = 0.5  # of a claim, from which more pictures should measure


def write_report(
    folder: Path, given: GaussianSequence, package: Package, done: EncodeReport, progress: Progress = silent
) -> Path:
    """Write index.html with the answer, charts, the worst picture and a film; gives its path.

    `given`: what was encoded, as it came. Raises ConfigError when they cannot be written, or without matplotlib.
    """
    (a, b), m, stages = (side_of(given, "given"), side_of(package, "encoded")), package.manifest, done.stages()
    words, views = shared_views(a, b)
    result = compare_two(a, b, range(a.frames), [_small(v) for v in before_both(a, b, views)[:VIEWS]], progress)
    summary, front = summarise(m, done.manifest_bytes), _small(first_views(m.region, m.world)[0])
    with report_folder(folder):
        worst, name = side_by_side(a, b, _worst(result)), f"frame-{_worst(result).frame:06d}.png"
        write_png(folder / name, worst)
        write_movie(folder / FILM_NAME, _film(a, b, before_both(a, b, [front])[0]), m.fps)
        pictures = [
            Picture("Seconds of each part of the work.", partial(_draw_stages, stages)),
            Picture("What viewers fetch and see; grey: no player should.", partial(plot_rungs, summary.rungs)),
            Picture("The worst picture of the worst frame.", name=name, panels=3, shape=worst.shape),
            Picture("All frames; left: as given, right: as encoded.", name=FILM_NAME),
        ]
        answer = {
            "good": _good(summary.rungs[0], result, words.removesuffix(f" of {a.name}"), done.uncertainty),
            "wrong": _wrong(result, summary.rungs, summary.top_rung_bytes),
            "bought": bought(stages),
            "useless": beaten_words({f"{r.key}+{r.state}": r.best for r in summary.rungs if r.psnr is not None})
            or "Nothing.",
            "change": advice(done) or "Nothing.",
        }
        decided = html_table([(str(number), line) for number, line in enumerate(m.decisions, 1)])
        more = {"What was decided": decided}
        return Page("What was encoded", answer, pictures, more).write(folder / "index.html")


def _small(camera: Camera) -> Camera:
    return resized(camera, min(1.0, (PIXELS / (camera.width * camera.height)) ** 0.5))


def _worst(result: Comparison) -> Seen:
    return next(seen for seen in result.ranked if seen.frame == result.frames[int(np.argmin(result.by_frame))])


def _film(a: Side, b: Side, camera: Camera) -> Iterator[NDArray[np.uint8]]:
    span = range(a.frames)
    first, second = (draw_frames(in_order(span, side.read(span))) for side in (a, b))
    for frame in span:
        yield np.concatenate([to_bytes(draw(frame, camera).rgb) for draw in (first, second)], axis=1)


def _draw_stages(stages: Sequence[Stage], axis: Any) -> None:
    axis.barh([stage.name.replace(" and ", "\nand ") for stage in stages], [s.seconds for s in stages], color=GREY)
    axis.invert_yaxis()
    axis.tick_params(labelsize=8)
    axis.set_xlabel("seconds")


def _good(top: RungSummary, result: Comparison, views: str, uncertainty: float) -> str:
    """Bytes and PSNR of the top rung: as claimed, and in views of the frames as they were given."""
    claim = f"The top rung takes {top.bytes_per_frame / 1e3:.1f} kB a frame, {top.mean_bps / 1e6:.2f} Mbit/s"
    if top.psnr is not None:
        claim += f", and is measured at {top.psnr:.1f} dB, {certainty_words(uncertainty)}"
    return f"{claim}. It shows the frames that were given at {result.quality.psnr:.1f} dB in {views}."


def _wrong(result: Comparison, rungs: Sequence[RungSummary], sizes: Mapping[str, int]) -> str:
    """The worst frame, and what holds the top rung back."""
    worst, mean = min(result.by_frame), result.quality.psnr
    far = ", far below the others" if worst < mean - UNEVEN_DB else ""
    told = [f"Frame {_worst(result).frame} is the worst with {worst:.1f} dB{far}.", holds_back(rungs)]
    largest = max(sizes, key=lambda kind: sizes[kind])
    told.append(f"Most bytes, {100 * sizes[largest] / sum(sizes.values()):.0f} %, are {largest}.")
    return " ".join(filter(None, told))


def holds_back(rungs: Sequence[RungSummary]) -> str:
    """Whether keys or states keep the top rung from more: those of which a kilobyte less costs more dB, in the next
    coarser ones. Empty where one of them has none, or nothing was measured.
    """
    top, worth = rungs[0], {}
    for r in reversed(rungs):  # the next coarser ones come last
        if top.psnr is not None and r.psnr is not None and r.bytes_per_frame < top.bytes_per_frame:
            name = "keys" if r.state == top.state else "states" if r.key == top.key else "both"
            worth[name] = 1e3 * (top.psnr - r.psnr) / (top.bytes_per_frame - r.bytes_per_frame)
    worth.pop("both", None)
    if len(worth) < 2:
        return ""
    most, least = sorted(worth, key=lambda name: -worth[name])
    costs = f"a kilobyte a frame less of them costs {worth[most]:.1f} dB, of its {least} {worth[least]:.1f} dB"
    return f"Its {most} hold it back: {costs}."


def bought(stages: Sequence[Stage]) -> str:
    """The parts of the work that took most of the time, the longest first, and what came of them."""
    total = sum(stage.seconds for stage in stages)
    longest = sorted((s for s in stages if s.seconds > LITTLE * total), key=lambda stage: -stage.seconds)
    told = (f"{s.name.capitalize()} took {s.seconds:.1f} s: {s.bought}." for s in longest)
    return f"{total:.0f} s in all. {' '.join(told)}"


def advice(done: EncodeReport) -> str:
    """What would make the next encode better or quicker; empty where that is nothing."""
    seconds = {stage.name: stage.seconds for stage in done.stages()}
    share, told = {name: s / max(1e-9, sum(seconds.values())) for name, s in seconds.items()}, []
    if not uncertainty_db(done.uncertainty) <= DOUBT_DB:  # also where it is not known
        told.append("The claim is not sure: more --measure-pictures make it so.")
    elif share["measuring"] > MUCH:
        told.append("Fewer --measure-pictures would be quicker, with a claim less sure.")
    if share["calibration"] > MUCH:
        told.append("--calibrate none does without trials, at the price of what they save.")
    if share["search"] > MUCH and (goal := done.goal) and goal.metric != DELTA_E:  # which chooses colours, too
        factor, _ = min(done.trials, key=lambda trial: abs(goal.misses(trial[1])))
        told.append(f"The next encode of this scene need not search: --quality {factor:.4g} is what was found.")
    return " ".join(told)

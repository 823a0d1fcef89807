"""The page of an encode: how near the package is to the frames that were given, and who did which job."""

from __future__ import annotations

import html
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec._report import new_figure, page, save_figure
from airgs_codec.errors import ConfigError
from airgs_codec.inspect.compare import Comparison, Seen, compare_two, side_by_side
from airgs_codec.inspect.sides import Side, before_both, shared_views, side_of
from airgs_codec.jobs.job import Record
from airgs_codec.jobs.report import NAME as JOBS_NAME
from airgs_codec.jobs.report import write_report as write_jobs
from airgs_codec.media.image import label, to_bytes, write_png
from airgs_codec.media.movie import write_movie
from airgs_codec.package.package import Package
from airgs_codec.package.region import first_views
from airgs_codec.progress import Progress, silent
from airgs_codec.render import Camera
from airgs_codec.render.compare import draw_frames, in_order
from airgs_codec.scene.camera import resized
from airgs_codec.scene.sequence import GaussianSequence

VIEWS = 4  # of each frame
PIXELS = 200_000  # of a picture, at most
SHOWN = 3  # frames, the worst ones
PSNR_NAME, FILM_NAME = "psnr.svg", "film.mp4"


def write_report(
    folder: Path, given: GaussianSequence, package: Package, jobs: Sequence[Record], progress: Progress = silent
) -> None:
    """Write index.html with a curve, the worst pictures and a film of both sides; jobs.html tells of the jobs.

    `given`: what was encoded, as it came. Raises ConfigError when they cannot be written, or without matplotlib.
    """
    a, b = side_of(given, "given"), side_of(package, "encoded")
    words, views = shared_views(a, b)
    views = [_small(view) for view in before_both(a, b, views)[:VIEWS]]
    result = compare_two(a, b, range(a.frames), views, progress)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _draw_curve(result, folder / PSNR_NAME)
        names = [f"frame-{seen.frame:06d}.png" for seen in _worst(result)]
        for seen, name in zip(_worst(result), names, strict=True):
            write_png(folder / name, side_by_side(a, b, seen))
        front = _small(first_views(package.manifest.region, package.manifest.world)[0])
        write_movie(folder / FILM_NAME, _film(a, b, result, before_both(a, b, [front])[0]), package.manifest.fps)
        if jobs:
            write_jobs(folder / JOBS_NAME, jobs)
        body = _body(result, words, package.manifest.decisions, names, bool(jobs))
        (folder / "index.html").write_text(page("What was encoded", body), encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{folder}: cannot write the report: {error}") from error


def _small(camera: Camera) -> Camera:
    return resized(camera, min(1.0, (PIXELS / (camera.width * camera.height)) ** 0.5))


def _worst(result: Comparison) -> list[Seen]:
    """The worst picture of each of the worst frames."""
    by_frame = {seen.frame: seen for seen in reversed(result.ranked)}
    frames = sorted(by_frame, key=lambda frame: by_frame[frame].psnr)
    return [by_frame[frame] for frame in frames[:SHOWN]]


def _draw_curve(result: Comparison, path: Path) -> None:
    figure = new_figure(9, 3)
    axes = figure.add_subplot()
    axes.plot(result.frames, result.by_frame, ".-", color="#2a6fbb")
    axes.set(xlabel="frame", ylabel="PSNR, dB")
    axes.grid(alpha=0.25)
    save_figure(figure, path)


def _film(a: Side, b: Side, result: Comparison, camera: Camera) -> Iterator[NDArray[np.uint8]]:
    """Both sides next to each other, frame after frame."""
    span = range(a.frames)
    first, second = (draw_frames(in_order(span, side.read(span))) for side in (a, b))
    for frame, quality in zip(span, result.by_frame, strict=True):
        shown = label(to_bytes(first(frame, camera).rgb), "given")
        yield np.concatenate([shown, label(to_bytes(second(frame, camera).rgb), f"encoded  {quality:.1f} dB")], axis=1)


def _body(result: Comparison, views: str, decisions: Sequence[str], pictures: Sequence[str], jobs: bool) -> str:
    by_frame = result.by_frame
    worst = int(np.argmin(by_frame))
    answer = (
        f"The best rung shows the frames that were given at {result.quality.psnr:.1f} dB; frame {worst} is the worst "
        f"with {by_frame[worst]:.1f} dB, in {views}."
    )
    lines = "".join(f"<li>{html.escape(line)}</li>" for line in decisions)
    shown = "".join(f'<img src="{name}" alt="given, encoded, difference">' for name in pictures)
    more = f'<p><a href="{JOBS_NAME}">Who did which job, and when</a></p>' if jobs else ""
    return (
        f'<p>{html.escape(answer)}</p><video src="{FILM_NAME}" controls loop muted style="max-width:100%"></video>'
        f'<img src="{PSNR_NAME}" alt="PSNR of each frame"><h2>Where it is worst</h2>{shown}'
        f"<h2>What was decided</h2><ul>{lines}</ul>{more}"
    )

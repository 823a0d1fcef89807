"""Rendered error against milliseconds of decoding a frame: rungs, keyframe tiers, keyframes alone.

Every rung is compared with the original in the same pictures, from views that the encoder has not drawn.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from airgs_codec._sampling import evenly_spaced
from airgs_codec.decoder.decode import decode_canonical, decode_frames
from airgs_codec.media.metrics import psnr
from airgs_codec.package.package import Package
from airgs_codec.package.region import draw_views
from airgs_codec.scene.gaussians import Gaussians
from tools.lab import timed
from tools.lab.numerics.rows import Bench, Place, Point, Row, Scene, picture_error

VIEWS, FRAMES, SEED = 4, 6, 1000  # of pictures that judge
RUNGS, TIERS, KEYFRAMES = "levels", "L0, first keyframe tiers", "keyframes alone"
UNIT = "dB PSNR"


def measure(bench: Bench) -> Iterator[Point]:
    for scene in bench.scenes:
        package = bench.ladder(scene)
        for place, work in ways(scene, package):
            make = partial(_row, scene, package, place, work, bench.repeats)
            yield Point("decode", scene, {"place": place, "repeats": bench.repeats}, make)


def ways(scene: Scene, package: Package) -> Iterator[tuple[Place, Callable[[], list[Gaussians]]]]:
    m = package.manifest
    for j, level in enumerate(m.levels):
        place = Place("decode", scene.name, RUNGS, level.id)
        yield place, partial(_frames, package, j, level.quality, None)
    for tiers in range(1, m.levels[0].tiers):
        place = Place("decode", scene.name, TIERS, f"{tiers} of {m.tiers}")
        yield place, partial(_frames, package, 0, 0, tiers)
    yield Place("decode", scene.name, KEYFRAMES, "Q0"), partial(_keyframes, package)


def _frames(package: Package, level: int, quality: int, tiers: int | None) -> list[Gaussians]:
    frames = decode_frames(package, 0, package.manifest.frames, level=level, keyframe_quality=quality, tiers=tiers)
    return [frame.gaussians for frame in frames]


def _keyframes(package: Package) -> list[Gaussians]:
    m, frames = package.manifest, []
    for number, group in enumerate(m.groups):
        g = decode_canonical(package, number, 0).to_gaussians()
        frames += [g] * (group.stop - group.start)
    return frames


def _row(scene: Scene, package: Package, place: Place, work: Callable[[], list[Gaussians]], repeats: int) -> list[Row]:
    frames, shown = package.manifest.frames, work()
    cameras = draw_views(package.manifest.region, VIEWS, SEED)
    numbers = evenly_spaced(frames, FRAMES)
    originals = {n: scene.sequence.load([n]).frames[0] for n in numbers}
    errors = [picture_error(shown[n], originals[n], camera) for n in numbers for camera in cameras]
    took = [t.times(1 / frames) for t in timed(work, repeats)]
    mean = psnr(float(np.mean(errors)))
    return [Row.by(place, took, (mean, mean, mean), UNIT, samples=[psnr(error) for error in errors])]

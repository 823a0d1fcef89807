"""Rendered error against milliseconds of decoding a frame: rungs, key tiers, keys alone; and stage by stage.

Every rung is compared with the original in the same pictures, from views that the encoder has not drawn.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

from airgs_codec._sampling import evenly_spaced
from airgs_codec.decoder.decode import Part, decode_canonical, decode_frames, decode_segment, decode_state
from airgs_codec.media.h264 import open_segment
from airgs_codec.media.metrics import psnr
from airgs_codec.package.package import Package
from airgs_codec.package.region import draw_views
from airgs_codec.scene.gaussians import Gaussians
from tools.lab.numerics.rows import Bench, Place, Point, Row, Scene, picture_error
from tools.lab.timing import Took, timed

VIEWS, FRAMES, SEED = 4, 6, 1000  # of pictures that judge
RUNGS, TIERS, KEYS = "levels", "L0, first key tiers", "keys alone"
UNIT = "dB PSNR"
STAGES = H264, CODES, KEY_UNITS, STATES = (
    "decoding H.264 of states",
    "taking codes from pictures",
    "decoding keys",
    "putting states on rows",
)


def measure(bench: Bench) -> Iterator[Point]:
    """Whole frames of every rung, then the stages of the top rung."""
    repeats = 3 if bench.quick else 11
    for scene in bench.scenes:
        package = bench.ladder(scene)
        for place, work in ways(scene, package):
            make = partial(_row, scene, package, place, work, repeats)
            yield Point("decode", scene, {"place": place, "repeats": repeats}, make)
        stages = partial(_stages, scene, package, repeats)
        yield Point("decode stages", scene, {"repeats": repeats}, stages)


def ways(scene: Scene, package: Package) -> Iterator[tuple[Place, Callable[[], list[Gaussians]]]]:
    """Ways to decode the package, each giving all frames."""
    m = package.manifest
    for j, level in enumerate(m.levels):
        place = Place("decode", "rungs", scene.name, RUNGS, level.id)
        yield place, partial(_frames, package, j, level.quality, None)
    for tiers in range(1, m.levels[0].tiers):
        place = Place("decode", "rungs", scene.name, TIERS, f"{tiers} of {m.tiers}")
        yield place, partial(_frames, package, 0, 0, tiers)
    yield Place("decode", "rungs", scene.name, KEYS, "Q0"), partial(_keys, package)


def _frames(package: Package, level: int, quality: int, tiers: int | None) -> list[Gaussians]:
    frames = decode_frames(package, 0, package.manifest.frames, level=level, key_quality=quality, part=Part(tiers))
    return [frame.gaussians for frame in frames]


def _keys(package: Package) -> list[Gaussians]:
    """Every frame as the canonical space of its group."""
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
    error = float(np.mean([picture_error(shown[n], originals[n], camera) for n in numbers for camera in cameras]))
    took = [t.times(1 / frames) for t in timed(work, repeats)]
    return [Row.of(place, took, [psnr(error)], UNIT, _size(package, place))]


def _size(package: Package, place: Place) -> float:
    """Bytes of a frame that a viewer of the rung fetches; NaN where no rung is meant."""
    m = package.manifest
    if place.curve != RUNGS:
        return float("nan")
    level = m.level_index(place.setting)
    return m.bytes_of(m.rung_files(m.levels[level].quality, level)) / m.frames


def _stages(scene: Scene, package: Package, repeats: int) -> list[Row]:
    """Milliseconds a frame of the top rung; a stage is the difference of two medians where it is not alone."""
    m = package.manifest
    moving = [i for i in range(len(m.segments)) if m.state_files(i, 0)]
    lengths = {i: m.segments[i].stop - m.segments[i].start for i in moving}
    bases = [decode_canonical(package, g, 0) for g in range(len(m.groups))]
    works: dict[str, Callable[[], object]] = {
        H264: lambda: [_pictures(package, i) for i in moving],
        CODES: lambda: [list(decode_state(package, i, 0, 0, n)) for i, n in lengths.items()],
        STATES: lambda: [
            list(decode_segment(package, i, bases[m.group_of(i)], 0, range(n))) for i, n in lengths.items()
        ],
        KEY_UNITS: lambda: [decode_canonical(package, g, 0) for g in range(len(m.groups))],
    }
    took = {name: [t.times(1 / m.frames) for t in timed(work, repeats)] for name, work in works.items()}
    alone = {
        H264: took[H264],
        CODES: beyond(took[CODES], took[H264]),
        KEY_UNITS: took[KEY_UNITS],
        STATES: beyond(took[STATES], took[CODES]),
    }
    return [Row.of(Place("decode", "stages", scene.name, stage, "L0"), alone[stage], []) for stage in STAGES]


def beyond(whole: Sequence[Took], part: Sequence[Took]) -> list[Took]:
    """Return what is left of each run without the median of its part."""
    cpu, wall = (float(np.median(column)) for column in zip(*part, strict=True))
    return [Took(t.cpu - cpu, t.wall - wall) for t in whole]


def _pictures(package: Package, index: int) -> int:
    """Decode the H.264 of a segment's states; gives the number of pictures."""
    m = package.manifest
    (media,) = m.state_files(index, 0)
    atlas = m.groups[m.group_of(index)].tiles[0].levels[0]
    return sum(1 for _ in open_segment(package.read(media), media, atlas.pages)[1])

"""Seconds, memory and bytes over the number of Gaussians and of frames: scenes encoded twice and decoded.

Made scenes, balls of Gaussians of which a tenth swings, of each number of rows have the first number of `--frames`;
scenes of each number of frames have `--few` rows. With `--sequence` it is that sequence instead, played forth and back
as long as `--frames` say, by the defaults of airgs-encode, its trial encodes included. Every encode and every decode is
a process of its own. cold: from nothing; warm: once more with the jobs that the first one kept; decode: every frame of
the top rung. A power law is fitted to cold and decode by least squares of the logarithms.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from airgs_codec.decoder.decode import decode_frames
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings, LevelSettings
from airgs_codec.jobs.work import Work
from airgs_codec.package.package import open_package
from airgs_codec.places.results import open_store
from airgs_codec.scene.sequence import open_sequence
from tools.lab import Lab, Page, Row, Section, Table, alone, listed, rows_of, setting
from tools.lab.made import forth_and_back, make_scene

SETTINGS = EncodeSettings(
    calibrate="none",
    measure_pictures=0,
    preset="veryfast",
    group_frames=30,
    keep_all=True,
    levels=(LevelSettings(0.0), LevelSettings(0.5, 2.0)),
)
HOW = (
    "Made scenes have no spherical harmonics past DC; groups of 30 frames, two levels, x264 preset veryfast, no trial "
    "encodes, quality not measured, nothing left out, though most of a ball is never seen. Memory is the most that the "
    "process of a step had, with Python and its libraries; CPU seconds are those of all its threads."
)
STEPS = ("cold", "warm", "decode")


@dataclass(frozen=True, slots=True)
class Options:
    rows: tuple[int, ...] = setting((10_000, 100_000, 1_000_000), "Gaussians of made scenes")
    frames: tuple[int, ...] = setting((30, 300, 3000), "frames")
    few: int = setting(2000, "Gaussians of made scenes of many frames")
    sequence: Path | None = setting(None, "a sequence to be measured in place of made scenes")
    views: Path | None = setting(None, "cameras of that sequence (default: its own)")


@dataclass(frozen=True, slots=True)
class Measured:
    rows: int
    frames: int
    step: str  # of STEPS
    seconds: float
    cpu_seconds: float
    peak_mb: float
    frame_bytes: float  # of the top rung


COLUMNS = {
    "rows": ("Gaussians", ",d"), "frames": ("frames", ",d"), "cold": ("encoding, CPU s", ".1f"),
    "peak_mb": ("memory, MB", ",.0f"), "warm": ("again, CPU s", ".1f"),
    "decode_ms": ("decoding, CPU ms a frame", ".1f"),
}  # fmt: skip


def run(options: Options, lab: Lab) -> Page:
    found: list[Measured] = []
    for one in _measured(options):
        found.append(one)
        lab.tell(str(one))
    few = options.few if options.sequence is None else found[0].rows
    section = Section(growth_words(found, few), tables=[Table("scale", scenes_of(found), COLUMNS)])
    return Page([section], HOW, data=[Table("scale-steps", rows_of(found))])


def scenes_of(found: Sequence[Measured]) -> list[Row]:
    scenes: dict[tuple[int, int], Row] = {
        (one.rows, one.frames): {"rows": one.rows, "frames": one.frames} for one in found
    }
    for one in found:
        row = scenes[one.rows, one.frames]
        if one.step == "decode":
            row["decode_ms"] = 1e3 * one.cpu_seconds / one.frames
        else:
            row[one.step] = one.cpu_seconds
        if one.step == "cold":
            row |= {"peak_mb": one.peak_mb, "kb_frame": one.frame_bytes / 1e3}
    return list(scenes.values())


def _measured(options: Options) -> Iterator[Measured]:
    place, first = options.sequence, options.frames[0]
    if place is not None:
        rows = open_sequence(place).headers[0].count
        views = options.views or next((path for path in [place / "transforms.json"] if path.exists()), None)
        for count in options.frames:
            yield from measure_scene(rows, count, partial(forth_and_back, place, count), views)
        return
    for count, frames in [*((n, first) for n in options.rows), *((options.few, n) for n in options.frames)]:
        yield from measure_scene(count, frames, partial(make_scene, count, frames))


def measure_scene(
    rows: int, frames: int, make: Callable[[Path], None], views: Path | None = None
) -> Iterator[Measured]:
    """Make a scene and take every step with it; one with `views` is encoded as airgs-encode does."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make(folder / "scene")
        for step in STEPS:
            how, _ = alone(take_step, step, folder, views)
            m = open_package(folder / "cold").manifest
            size = m.bytes_of(m.rung_files(0, 0)) / m.frames
            yield Measured(rows, frames, step, how.took.wall, how.took.cpu, how.peak_mb, size)


def take_step(step: str, folder: Path, views: Path | None) -> None:
    """One of STEPS; calibrations are kept in the folder."""
    os.environ["XDG_CACHE_HOME"] = str(folder)
    if step != "decode":
        settings = SETTINGS if views is None else EncodeSettings()
        encode(open_sequence(folder / "scene", views=views), folder / step, settings, work=_work(folder))
        return
    package = open_package(folder / "cold")
    for _ in decode_frames(package, 0, package.manifest.frames):
        pass


def _work(folder: Path) -> Work:
    return Work(open_store(folder / "work"))


def fit_power(sizes: Sequence[float], values: Sequence[float]) -> tuple[float, float]:
    """a and k of the power law value = a size^k that fits best: least squares of the logarithms."""
    k, log_a = np.polyfit(np.log(sizes), np.log(values), 1)
    return float(np.exp(log_a)), float(k)


def growth_words(found: Sequence[Measured], few: int) -> str:
    """How much longer twice the Gaussians take, and twice the frames, of which scenes of `few` rows tell."""
    parts = []
    for step, what in (("cold", "encoding"), ("decode", "decoding")):
        times = []
        for name in ("rows", "frames"):
            same = [one for one in found if one.step == step and (one.rows == few) == (name == "frames")]
            if len(same) > 1:
                power = fit_power([getattr(one, name) for one in same], [one.cpu_seconds for one in same])[1]
                times.append(f"{2**power:.1f} times for twice the {'Gaussians' if name == 'rows' else name}")
        if times:
            parts.append(f"{what} takes {listed(times).replace(' for', ' as long for', 1)}")
    return f"Of CPU time, {'; '.join(parts)}." if parts else ""

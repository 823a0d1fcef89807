"""Seconds, memory and bytes over the number of Gaussians and of frames: scenes encoded twice and decoded.

Made scenes, balls of Gaussians of which a tenth swings, of each number of rows have the first number of `--frames`;
scenes of each number of frames have `--few` rows. Every encode and every decode is a process of its own. cold: from
nothing; warm: once more with the runs that the first one stored; decode: every frame of the top rung. A power law is
fitted to cold and decode by least squares of the logarithms.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from airgs_codec.decoder.decode import decode_frames
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings, LevelSettings
from airgs_codec.package.package import Package, open_package
from airgs_codec.scene.sequence import open_sequence
from tools.lab import Lab, Page, Row, Section, Table, alone, listed, rows_of, setting
from tools.lab.made import make_scene

LEVELS = LevelSettings(0.0), LevelSettings(0.5, 2.0)
SETTINGS = EncodeSettings(
    calibrate="none", measure_pictures=0, preset="veryfast", group_frames=30, keep_all=True, levels=LEVELS
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
    sizes = [(rows, options.frames[0]) for rows in options.rows] + [(options.few, frames) for frames in options.frames]
    for rows, frames in sizes:
        found += measure_scene(rows, frames)
        lab.tell(str(found[-1]))
    section = Section(growth_words(found, options.few), tables=[Table("scale", scenes_of(found), COLUMNS)])
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


def measure_scene(rows: int, frames: int) -> Iterator[Measured]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_scene(rows, frames, folder / "scene")
        for step in STEPS:
            how, _ = alone(take_step, step, folder)
            m = open_package(folder / "cold").manifest
            size = m.bytes_of(m.rung_files(0, 0)) / m.frames
            yield Measured(rows, frames, step, how.took.wall, how.took.cpu, how.peak_mb, size)


def take_step(step: str, folder: Path) -> None:
    if step == "decode":
        package = open_package(folder / "cold")
        decode_all(package, package.manifest.frames)
    else:
        encode(open_sequence(folder / "scene"), folder / step, SETTINGS, work=folder / "work")


def decode_all(package: Package, frames: int) -> None:
    for _ in decode_frames(package, 0, frames):
        pass


def growth_words(found: Sequence[Measured], few: int) -> str:
    """How much longer twice the Gaussians take, and twice the frames, of which scenes of `few` rows tell."""
    parts = []
    for step, what in (("cold", "encoding"), ("decode", "decoding")):
        times = []
        for name in ("rows", "frames"):
            same = [one for one in found if one.step == step and (one.rows == few) == (name == "frames")]
            if len(same) > 1:
                sizes, seconds = np.log([[getattr(one, name), one.cpu_seconds] for one in same]).T
                power = np.polyfit(sizes, seconds, 1)[0]
                times.append(f"{2**power:.1f} times for twice the {'Gaussians' if name == 'rows' else name}")
        if times:
            parts.append(f"{what} takes {listed(times).replace(' for', ' as long for', 1)}")
    return f"Of CPU time, {'; '.join(parts)}." if parts else ""

"""Milliseconds of decoding a frame of a million Gaussians, against ASKED_MS: the top rung, medians of all repeats.

Scenes of one group, made and encoded in the folder with the settings of `scale` unless they are there already: balls of
which every Gaussian swings by itself, by so many of its standard deviations, and, with `--fox`, a ring of copies of the
first twelve frames of a sequence. A Gaussian moves that has states.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from airgs_codec.decoder.decode import decode_frames
from airgs_codec.encoder.publish import encode
from airgs_codec.jobs.job import code_digest
from airgs_codec.package.package import Package, open_package
from airgs_codec.scene.sequence import open_sequence
from tools.lab import Lab, Page, Row, Section, Table, middle, setting, timed
from tools.lab.bench.scale import SETTINGS
from tools.lab.made import make_ring, make_swinging

COLUMNS = {
    "package": ("scene", ""), "Gaussians": ("Gaussians", ",d"), "with states": ("that move", ",d"),
    "kb_frame": ("kB a frame", ",.0f"), "ms a frame": ("ms a frame", ".0f"), "CPU ms a frame": ("CPU ms", ".0f"),
}  # fmt: skip
ASKED_MS = 60  # a frame
LOOPED = 12  # frames of the sequence that copies in the ring show


@dataclass(frozen=True, slots=True)
class Options:
    fox: Path | None = setting(None, "a sequence, for the ring of its copies")
    rows: int = setting(1_000_000, "Gaussians")
    frames: int = setting(30, "frames")
    swings: tuple[float, ...] = setting((0.05, 0.5), "by which Gaussians of balls swing, in their standard deviations")
    repeat: int = setting(5, "runs of each part")


def run(options: Options, lab: Lab) -> Page:
    rows: list[Row] = []
    for name, make in scenes(options).items():
        package = prepared(lab.folder / f"{name.replace(' ', '-')}-{code_digest(encode)[:8]}", make)
        rows.append(measure(name, package, options.repeat))
    how = f"Of the top rung, {options.frames} frames, medians of {options.repeat} runs."
    return Page([Section(words(rows), tables=[Table("million", rows, COLUMNS)])], how)


def measure(scene: str, package: Package, repeat: int) -> Row:
    m = package.manifest
    count, moving = m.groups[0].count, m.groups[0].tiles[0].levels[0].rows
    size = m.bytes_of(m.rung_files(0, 0)) / m.frames
    took = middle(timed(lambda: sum(1 for _ in decode_frames(package, 0, m.frames)), repeat)).times(1e3 / m.frames)
    return {
        "package": scene, "Gaussians": count, "with states": moving, "bytes a frame": size, "part": "all",
        "ms a frame": took.wall, "CPU ms a frame": took.cpu, "kb_frame": size / 1e3, "share": moving / count,
    }  # fmt: skip


def words(rows: Sequence[Row]) -> str:
    slow = min((row["share"] for row in rows if row["ms a frame"] > ASKED_MS), default=None)
    fast = [row for row in rows if slow is None or row["share"] < slow]
    asked = f"at most {ASKED_MS} ms a frame"
    if not fast:
        least = min(row["ms a frame"] for row in rows)
        return f"Asked are {asked}, which no scene meets: the quickest takes {least:.0f} ms."
    most = max(fast, key=lambda row: row["share"])
    met = (
        f"Asked are {asked}, met where up to {100 * most['share']:.0f} % of the rows move ({most['ms a frame']:.0f} ms)"
    )
    return f"{met}, not from {100 * slow:.0f} % on." if slow is not None else f"{met}."


def scenes(options: Options) -> dict[str, Callable[[Path], None]]:
    made: dict[str, Callable[[Path], None]] = {
        f"ball, all swing by {swing:g}": partial(make_swinging, options.rows, options.frames, swing)
        for swing in options.swings
    }
    if options.fox:
        copies = max(1, round(options.rows / open_sequence(options.fox).headers[0].count))
        made[f"ring of {copies} foxes"] = partial(make_ring, options.fox, copies, LOOPED, options.frames)
    return made


def prepared(folder: Path, make: Callable[[Path], None]) -> Package:
    if not (folder / "package").is_dir():
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / "scene").is_dir():
            make(folder / "scene")
        encode(open_sequence(folder / "scene"), folder / "package", SETTINGS)
    return open_package(folder / "package")

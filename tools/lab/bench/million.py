"""Milliseconds of decoding a frame of a million Gaussians, part by part, as `decode` has it, against ASKED_MS.

Two scenes of one group each, made and encoded in the folder with the settings of `scale` unless they are there already:
a ball of which every Gaussian swings by itself, and, with `--fox`, a ring of copies of the first twelve frames of a
sequence (tools/make_wide_scene.py).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from airgs_codec.encoder.publish import encode
from airgs_codec.package.package import Package, open_package
from airgs_codec.scene.sequence import open_sequence
from tools.lab import Lab, Page, setting
from tools.lab.bench.decode import measure, page_of
from tools.lab.bench.scale import SETTINGS
from tools.lab.made import make_swinging
from tools.make_wide_scene import make_scene as make_ring

ASKED_MS = 60  # a frame
LOOPED = 12  # frames of the sequence that copies in the ring show


@dataclass(frozen=True, slots=True)
class Options:
    """The scenes."""

    fox: Path | None = setting(None, "a sequence, for the ring of its copies")
    rows: int = setting(1_000_000, "Gaussians")
    frames: int = setting(30, "frames")
    swing: float = setting(0.05, "by which Gaussians of the ball swing, in its standard deviations")
    repeat: int = setting(5, "runs of each part")


def run(options: Options, lab: Lab) -> Page:
    """Make what is missing, and measure."""
    rows = []
    for name, make in scenes(options).items():
        rows += measure(name, prepared(lab.folder / name.replace(" ", "-"), make), options.repeat)
    return replace(page_of(rows), how=f"Of the top rung; at most {ASKED_MS} ms a frame are asked for.")


def scenes(options: Options) -> dict[str, Callable[[Path], None]]:
    """Return what makes each scene in a folder."""
    made: dict[str, Callable[[Path], None]] = {
        f"all swing by {options.swing}": lambda folder: make_swinging(
            options.rows, options.frames, options.swing, folder
        )
    }
    if options.fox:
        sequence = open_sequence(options.fox)
        copies = max(1, round(options.rows / len(sequence.load([0]).frames[0])))
        made["ring of foxes"] = lambda folder: make_ring(sequence, folder, (0, LOOPED), copies, options.frames)
    return made


def prepared(folder: Path, make: Callable[[Path], None]) -> Package:
    """The package of a scene, which is made where it is not there."""
    if not (folder / "package").is_dir():
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / "scene").is_dir():
            make(folder / "scene")
        encode(open_sequence(folder / "scene"), folder / "package", SETTINGS)
    return open_package(folder / "package")

"""What a round trip through each splat format costs: PSNR, bytes, seconds, memory.

Frame 0 of a scene, as the format holds it, is written and read again; PSNR is of all pictures by the scene's held-out
cameras together, against the frame as it was. Files are timed with copies of that frame beside each other, --rows
Gaussians: the median of --repeat runs, each in a process of its own, whose largest resident memory (with that of the
library's process, where it has one) counts the interpreter, too. Writing is timed once.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from pathlib import Path
from statistics import median

import numpy as np

from airgs_codec.inspect.compare import Comparison, compare_two
from airgs_codec.inspect.sides import compared_views, open_side
from airgs_codec.scene.formats.form import FrameFormat
from airgs_codec.scene.formats.ply import read_ply, write_ply
from airgs_codec.scene.formats.table import FRAMES, choose_target, write_frames
from airgs_codec.scene.gaussians import Gaussians, join_rows
from airgs_codec.scene.sequence import GaussianSequence, open_sequence
from tools.lab import Lab, Page, Row, Section, Table, Took, alone, seconds_of, setting

SCENE = Path("tests/data/fox")
NOISE = 0.02  # in the units of each attribute: writers cluster equal rows, which no scene has
GAP = 1.5  # between copies of a frame, of its extent


@dataclass(frozen=True, slots=True)
class Options:
    """What is written."""

    scene: Path = setting(SCENE, "a sequence with cameras")
    rows: int = setting(200_000, "Gaussians of the files that are timed")
    repeat: int = setting(3, "readings of each")


def run(options: Options, lab: Lab) -> Page:
    """The table of formats."""
    with tempfile.TemporaryDirectory() as folder:
        large = Path(folder) / "large.ply"
        write_ply(large, copies(open_sequence(options.scene).load([0]).frames[0], options.rows))
        frames = [frame_row(form, options.scene, large, options.repeat) for form in FRAMES]
    answer = f"Files are timed with {options.rows:,} Gaussians."
    return Page([Section(answer, tables=[Table("formats", frames)])])


def copies(frame: Gaussians, rows: int) -> Gaussians:
    """So many Gaussians: a frame again and again, side by side in a cube, all attributes with a little noise."""
    count = -(-rows // len(frame))
    side = round(count ** (1 / 3) + 0.5)
    step = GAP * np.ptp(frame.means, axis=0)
    places = np.stack(np.unravel_index(np.arange(count), (side + 1,) * 3), axis=1) * step
    moved = [replace(frame, means=(frame.means + place).astype(np.float32)) for place in places]
    joined = join_rows(moved).take(slice(rows))
    random = np.random.default_rng(0)
    columns = [getattr(joined, field.name) for field in fields(Gaussians)]
    return Gaussians(*(c + np.float32(NOISE) * random.standard_normal(c.shape, np.float32) for c in columns))


def write(source: Path, target: Path) -> Took:
    """Return what writing a .ply to the format of another name took."""
    frame = read_ply(source)
    return seconds_of(lambda: write_frames(choose_target(str(target), None, 1), [(0, frame)], Fraction(1)))[0]


def read(target: Path) -> Took:
    """Return what reading a file took."""
    return seconds_of(lambda: open_sequence(target).read(0))[0]


def round_trip(scene: Path, sequence: GaussianSequence, written: Path) -> Comparison:
    """A written file against the scene, by its held-out cameras."""
    cameras = compared_views(sequence.cameras, None)
    other = open_side(str(written))
    return compare_two(open_side(str(scene)), other, range(other.frames), cameras)


def facts(form: FrameFormat) -> Row:
    """Return what the code knows without measuring."""
    holds = form.holds
    degrees = f"0 to {holds.sh_degree}" if holds.sh_degree else "none"
    order = "kept" if holds.keeps_rows else "lost"
    return {"format": form.name, "SH": degrees, "order of rows": order, "rounds": holds.rounding or "nothing"}


def frame_row(form: FrameFormat, scene: Path, large: Path, repeat: int) -> Row:
    """A row of the table of formats that hold one frame."""
    sequence = open_sequence(scene)
    with tempfile.TemporaryDirectory() as folder:
        small, big = Path(folder) / f"small.{form.key}", Path(folder) / f"big.{form.key}"
        write_frames(choose_target(str(small), None, 1), [(0, sequence.load([0]).frames[0])], Fraction(1))
        quality = round_trip(scene, sequence, small).quality
        _, written = alone(write, large, big)
        runs = [alone(read, big) for _ in range(repeat)]
        return facts(form) | {
            "PSNR, dB": quality.psnr, "a frame, kB": small.stat().st_size / 1e3, "large, MB": big.stat().st_size / 1e6,
            "write, s": written.wall, "read, s": median(took.wall for _, took in runs),
            "memory, MB": max(process.peak_mb for process, _ in runs),
        }  # fmt: skip

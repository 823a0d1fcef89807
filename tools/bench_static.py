"""Static splats as packages and as SPZ: bytes of both at equal quality, by the same cameras.

    python -m tools.bench_static FILE … [--above DB] [--draws N] [--keep DIR]

Each file is written as SPZ and encoded twice: first for its viewing region, from which cameras are drawn that no
decision of the encoder sees; then with the PSNR that SPZ has by these cameras, and --above more, as its target. Bytes
of a package are those of everything that a viewer of its top rung fetches, both manifests counted; those of SPZ are
its file's. PSNR is of the error of all pictures together, against the file as it came.
"""

from __future__ import annotations

import argparse
import os
import platform
import tempfile
from contextlib import ExitStack
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from airgs_codec import EncodeSettings
from airgs_codec.cli.common import Bar
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.rate_target import PSNR, Goal, OutOfReachError
from airgs_codec.encoder.settings import as_preview
from airgs_codec.inspect.compare import region_views
from airgs_codec.inspect.sides import Side, open_side
from airgs_codec.inspect.two import compare_two
from airgs_codec.jobs.work import temporary_work
from airgs_codec.package.region import CHECKING
from airgs_codec.package.tables import Region
from airgs_codec.render import Camera
from airgs_codec.scene.formats.write import choose_target, write_frames
from airgs_codec.scene.sequence import open_sequence

ABOVE_DB = 0.5
DRAWS = 12


@dataclass(frozen=True, slots=True)
class Measured:
    """One file in one form."""

    size: float  # bytes
    psnr: float  # dB
    worst: float  # dB, of the worst picture

    def __str__(self) -> str:
        return f"{self.size / 1e3:.1f} kB, {self.psnr:.1f} dB ({self.worst:.1f})"


@dataclass(frozen=True, slots=True)
class Row:
    """A file, as SPZ and as a package."""

    name: str
    gaussians: int
    sh_degree: int
    spz: Measured
    ours: Measured

    def markdown(self) -> str:
        """A line of the table."""
        share = f"{100 * self.ours.size / self.spz.size:.0f} %"
        return f"| {self.name} | {self.gaussians:,}, SH {self.sh_degree} | {self.spz} | {self.ours} | {share} |"


def measure(path: Path, folder: Path, above: float, draws: int) -> Row:
    """Write a file's first frame both ways into a folder, and look at them."""
    sequence, bar = open_sequence(path), Bar()
    original, spz = open_side(str(path)), folder / "frame.spz"
    write_frames(choose_target(str(spz), None, 1), [(0, sequence.load([0]).frames[0])], Fraction(1))
    first, final = folder / "first.airgs", folder / "final.airgs"
    encode(sequence, first, as_preview(EncodeSettings()))
    cameras = region_views(_region(first), draws, CHECKING)
    theirs = _look(original, open_side(str(spz)), cameras)
    with temporary_work(bar) as work:
        try:
            encode(sequence, final, EncodeSettings(), goal=Goal(PSNR, theirs.psnr + above), work=work)
        except OutOfReachError as error:  # files that are rounded like SPZ already: as near as it comes
            encode(sequence, final, EncodeSettings(quality=error.factor), work=work)
    bar.close()
    ours = _look(original, open_side(str(final)), cameras)
    return Row(_name(path), sequence.headers[0].count, sequence.sh_degree, theirs, ours)


def _region(package: Path) -> Region:
    region = open_side(str(package)).region
    assert region is not None, "the encoder finds a region for every scene"
    return region


def _look(original: Side, other: Side, cameras: list[Camera]) -> Measured:
    result = compare_two(original, other, range(1), cameras)
    return Measured(other.bytes_per_frame, result.quality.psnr, result.worst.psnr)


def _name(path: Path) -> str:
    return f"{path.parent.name}/{path.name}" if path.is_dir() else path.name


def main() -> None:
    """Measure all files and print the table."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench_static", description=__doc__.partition("\n")[0])
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE")
    parser.add_argument("--above", type=float, default=ABOVE_DB, metavar="DB", help=f"(default: {ABOVE_DB})")
    parser.add_argument("--draws", type=int, default=DRAWS, metavar="N", help=f"cameras (default: {DRAWS})")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="leave the files of FILE in DIR/FILE")
    args = parser.parse_args()
    print(f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}")
    print("| file | Gaussians | SPZ, PSNR (worst picture) | airgs | bytes of SPZ's |\n|---|---|---|---|---|")
    for path in args.files:
        with ExitStack() as stack:
            folder = args.keep / path.stem if args.keep else Path(stack.enter_context(tempfile.TemporaryDirectory()))
            folder.mkdir(parents=True, exist_ok=True)
            print(measure(path, folder, args.above, args.draws).markdown(), flush=True)


if __name__ == "__main__":
    main()

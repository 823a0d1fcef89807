"""Static splats as packages and as SPZ: bytes of both at equal quality, by the same cameras.

Each file is written as SPZ and encoded twice: first for its viewing region, from which cameras are drawn that no
decision of the encoder sees; then with the PSNR that SPZ has by these cameras, and ABOVE more, as its target. Bytes
of a package are those of everything that a viewer of its top rung fetches, both manifests counted; those of SPZ are
its file's. PSNR is of the error of all pictures together, against the file as it came. The files stay in the folder.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path

from airgs_codec import EncodeSettings
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import as_fast
from airgs_codec.encoder.target import PSNR, Goal, OutOfReachError
from airgs_codec.inspect.compare import Side, compare_two, open_side
from airgs_codec.package.region import CHECKING, draw_views
from airgs_codec.package.tables import Region
from airgs_codec.render import Camera
from airgs_codec.scene.formats.table import choose_target, write_frames
from airgs_codec.scene.sequence import open_sequence
from tools.lab import Lab, Page, Row, Section, Table, required

ABOVE, DRAWS = 0.5, 96  # dB that packages have to be better than SPZ, and cameras
COLUMNS = {
    "file": ("file", ""), "rows": ("Gaussians", ",d"), "spz_kb": ("SPZ, kB", ",.0f"), "spz_psnr": ("its PSNR", ".1f"),
    "spz_worst": ("worst 5 %", ".1f"), "airgs_kb": ("airgs, kB", ",.0f"), "airgs_psnr": ("its PSNR", ".1f"),
    "airgs_worst": ("worst 5 %", ".1f"), "share": ("share", ".0%"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Options:
    files: tuple[Path, ...] = required("static splats, or sequences, of which the first frame")


@dataclass(frozen=True, slots=True)
class Measured:
    kb: float
    psnr: float  # dB
    worst: float  # dB, below which 5 % of pictures are


def run(options: Options, lab: Lab) -> Page:
    rows = [measure(path, lab) for path in options.files]
    how = (
        f"SPZ is version 3 with all bits of SH; packages aim {ABOVE:g} dB above its PSNR, in {DRAWS} "
        "views that decided nothing."
    )
    return Page([Section("", tables=[Table("static", rows, COLUMNS)])], how)


def measure(path: Path, lab: Lab) -> Row:
    folder = lab.folder / path.stem
    folder.mkdir(exist_ok=True)
    sequence = open_sequence(path)
    original, spz = open_side(str(path)), folder / "frame.spz"
    write_frames(choose_target(str(spz), None, 1), [(0, sequence.load([0]).frames[0])], Fraction(1))
    first, final = folder / "first.airgs", folder / "final.airgs"
    encode(sequence, first, as_fast(EncodeSettings()))
    cameras = draw_views(_region(first), DRAWS, CHECKING)
    theirs = _look(original, open_side(str(spz)), cameras)
    try:
        encode(sequence, final, goal=Goal(PSNR, theirs.psnr + ABOVE), progress=lab.progress)
    except OutOfReachError as error:  # files that are rounded like SPZ already: as near as it comes
        encode(sequence, final, EncodeSettings(quality=error.factor), progress=lab.progress)
    ours = _look(original, open_side(str(final)), cameras)
    row = {"file": _name(path), "rows": sequence.headers[0].count, "sh_degree": sequence.sh_degree}
    row |= {f"{name}_{key}": v for name, m in (("spz", theirs), ("airgs", ours)) for key, v in asdict(m).items()}
    return row | {"share": ours.kb / theirs.kb}


def _region(package: Path) -> Region:
    region = open_side(str(package)).region
    assert region is not None, "the encoder finds a region for every scene"
    return region


def _look(original: Side, other: Side, cameras: list[Camera]) -> Measured:
    result = compare_two(original, other, range(1), cameras)
    return Measured(other.bytes_per_frame / 1e3, result.quality.psnr, result.quality.low)


def _name(path: Path) -> str:
    return f"{path.parent.name}/{path.name}" if path.is_dir() else path.name

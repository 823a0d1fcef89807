"""Do packages have the quality that they claim? Every rung measured again where no decision of the encoder looked.

    python -m tools.bench_claims SCENE[=VIEWS] ... [--targets default,36,40,43] [--single-rungs 0.5,1,2,4,8,16] -o FILE

Each scene is encoded with `--target-psnr` for each target. For every rung the PSNR that the package claims stands
beside that of fresh views over all frames, errors pooled as in a package, and that of the worst of these views.
`--from` takes views from a file, its held-out ones if it has any. With `--single-rungs`, packages of one level are
encoded at these quality factors, and each rung is compared with what its bytes buy on the curve of their top rungs.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from airgs_codec import EncodeSettings, encode, open_package, open_sequence
from airgs_codec._report import table
from airgs_codec.cli.common import run_command
from airgs_codec.encoder.rate_target import PSNR, Goal
from airgs_codec.encoder.settings import LevelSettings
from airgs_codec.errors import AirgsError, ConfigError
from airgs_codec.inspect.compare import compared_views, rung_streams
from airgs_codec.inspect.summary import RungSummary, summarise
from airgs_codec.media.metrics import mse, psnr
from airgs_codec.package.store import Package
from airgs_codec.render import Camera, read_cameras, render
from airgs_codec.scene.orbits import orbit_views
from airgs_codec.scene.sequence import GaussianSequence

DEFAULT = "default"  # in place of a target: the encoder's own quality
TARGETS = "36,40,43"  # dB
NEIGHBOURS = 3  # a fresh view lies between a camera and one of so many nearest
PLAIN: dict[type, Callable[[str], Any]] = {
    bool: {"True": True, "False": False}.__getitem__,
    int: int,
    float: float,
    str: str,
}  # what --set can read
HEAD = [
    "scene",
    "target",
    "rung",
    "kB/frame",
    "claimed",
    "measured",
    "off",
    "worst view",
    "worst picture",
    "to one rung",
]


@dataclass(frozen=True, slots=True)
class Measured:
    """PSNR in dB of one rung on fresh views."""

    mean: float  # errors pooled over views and frames
    worst_view: float  # errors pooled over frames
    worst_picture: float


@dataclass(frozen=True, slots=True)
class Row:
    """A rung of a package: what was promised and what was found."""

    scene: str
    target: str  # dB, or DEFAULT
    rung: str
    kilobytes: float  # a frame, of everything a viewer fetches
    claimed: float | None  # dB; None: the package does not say
    measured: Measured
    ladder: bool  # whether the package says that no mixture of two other rungs beats it
    single: float | None = None  # dB, of a package of its own with as many bytes; None: not known

    @property
    def off(self) -> float:
        """By how much more was found than was claimed, in dB; 0 where nothing was."""
        return 0.0 if self.claimed is None else self.measured.mean - self.claimed

    def cells(self) -> list[str]:
        """As a line of the table."""
        claimed = "-" if self.claimed is None else f"{self.claimed:.2f}"
        m = self.measured
        figures = [f"{m.mean:.2f}", f"{self.off:+.2f}", f"{m.worst_view:.2f}", f"{m.worst_picture:.2f}"]
        single = "-" if self.single is None else f"{m.mean - self.single:+.2f}"
        mark = "*" if self.ladder else ""
        return [self.scene, self.target, self.rung + mark, f"{self.kilobytes:.2f}", claimed, *figures, single]


@dataclass(frozen=True, slots=True, eq=False)
class Bench:
    """What all scenes are encoded and measured with."""

    settings: EncodeSettings
    draws: int  # fresh views
    seed: int  # of their draw
    frames: int  # at most so many are measured
    views: tuple[Camera, ...]  # measured from, in place of fresh ones; empty: draw them
    folder: Path  # of the packages

    def looks(self, sequence: GaussianSequence) -> list[Camera]:
        """The cameras that quality is measured from."""
        return list(self.views) or fresh_views(sequence, self.draws, self.seed)


def fresh_views(sequence: GaussianSequence, count: int, seed: int) -> list[Camera]:
    """`count` views between cameras of the scene, of which no encoder knows; round the orbit where it has none."""
    rng = np.random.default_rng(seed)
    cameras = list(sequence.cameras) or orbit_views(sequence.read(len(sequence) // 2))
    places = np.stack([camera.position for camera in cameras])
    views = []
    for number in range(count):
        first = int(rng.integers(len(cameras)))
        near = np.argsort(np.linalg.norm(places - places[first], axis=1), kind="stable")[1 : NEIGHBOURS + 1]
        second = int(rng.choice(near)) if len(near) else first
        view = between(cameras[first], cameras[second], float(rng.uniform()))
        views.append(replace(view, name=f"fresh{number:02d}"))
    return views


def between(a: Camera, b: Camera, share: float) -> Camera:
    """`a` moved and turned by `share` of the way to `b`."""
    ends = Rotation.from_matrix(np.stack([c.world_to_camera[:3, :3] for c in (a, b)]))
    matrix = np.eye(4)
    matrix[:3, :3] = Slerp([0, 1], ends)(share).as_matrix()
    matrix[:3, 3] = -matrix[:3, :3] @ ((1 - share) * a.position + share * b.position)
    return replace(a, world_to_camera=matrix)


def measure(package: Package, sequence: GaussianSequence, cameras: Sequence[Camera], most: int) -> dict[str, Measured]:
    """Every rung against the original, over at most `most` evenly spaced frames."""
    step = -(-len(sequence) // most)
    frames = range((len(sequence) - 1) % step // 2, len(sequence), step)
    streams = rung_streams(package, frames)
    errors = {name: np.zeros((len(frames), len(cameras))) for name in streams}
    for index, number in enumerate(frames):
        original = sequence.load([number]).frames[0]
        pictures = [render(original, camera).rgb for camera in cameras]
        for name, stream in streams.items():
            shown = next(stream)
            pairs = zip(cameras, pictures, strict=True)
            errors[name][index] = [mse(render(shown, camera).rgb, picture) for camera, picture in pairs]
    return {name: pooled(e) for name, e in errors.items()}


def pooled(errors: NDArray[np.float64]) -> Measured:
    """From mean squared errors of (frames, views)."""
    return Measured(*(round(psnr(float(e)), 3) for e in (errors.mean(), errors.mean(axis=0).max(), errors.max())))


def rows_of(scene: str, target: str, package: Package, found: dict[str, Measured]) -> list[Row]:
    """The rungs of a package by falling bytes."""
    rungs = summarise(package.manifest, package.manifest_bytes).rungs
    by_size = sorted(rungs, key=lambda rung: -rung.bytes_per_frame)
    return [Row(scene, target, _name(r), r.bytes_per_frame / 1e3, r.psnr, found[_name(r)], r.best) for r in by_size]


def _name(rung: RungSummary) -> str:
    return f"{rung.key}+{rung.state}"


def bench_package(
    bench: Bench, sequence: GaussianSequence, target: str, settings: EncodeSettings, goal: Goal | None = None
) -> list[Row]:
    """Encode and measure one package, named for its scene and `target`. Raises ConfigError for a goal out of reach."""
    scene = sequence.folder.resolve().name
    folder = bench.folder / f"{scene}-{target}.airgs"
    began = time.perf_counter()
    encode(sequence, folder, settings, goal=goal)
    encoded = time.perf_counter()
    package = open_package(folder)
    found = measure(package, sequence, bench.looks(sequence), bench.frames)
    seconds = f"{encoded - began:.0f} s to encode, {time.perf_counter() - encoded:.0f} s to measure"
    print(f"{scene} {target}: {seconds}", file=sys.stderr, flush=True)
    return rows_of(scene, target, package, found)


def bench_scene(
    bench: Bench, sequence: GaussianSequence, targets: Sequence[str], factors: Sequence[float]
) -> Iterator[Row]:
    """All rungs at all targets; a target that the encoder refuses is a line on stderr."""
    alone = replace(bench.settings, calibrate="steps", levels=(LevelSettings(0.0),), tiers=(1.0,))
    curve = [bench_package(bench, sequence, f"x{f:g}", replace(alone, quality=f))[0] for f in factors]
    for target in targets:
        goal = None if target == DEFAULT else Goal(PSNR, float(target))
        try:
            rows = bench_package(bench, sequence, target, bench.settings, goal)
        except AirgsError as error:
            print(f"{sequence.folder.name} {target}: {error}", file=sys.stderr, flush=True)
            continue
        yield from (replace(row, single=bought(curve, row.kilobytes)) for row in rows)
    yield from curve


def bought(curve: Sequence[Row], kilobytes: float) -> float | None:
    """PSNR that packages of one rung have at a size, linear in its logarithm; None outside the sizes of the curve."""
    points = sorted((row.kilobytes, row.measured.mean) for row in curve)
    if not points or not points[0][0] <= kilobytes <= points[-1][0]:
        return None
    sizes, qualities = np.array(points).T
    return round(float(np.interp(np.log(kilobytes), np.log(sizes), qualities)), 3)


def verdict(rows: Sequence[Row]) -> Iterator[str]:
    """For each package how far claims are off, how far its ladder is below the curve, which of its rungs are beaten."""
    for scene, target in dict.fromkeys((row.scene, row.target) for row in rows):
        of = [row for row in rows if (row.scene, row.target) == (scene, target)]
        words = [f"claims off by {max((row.off for row in of), key=abs):+.2f} dB at most"]
        ladder = [row for row in of if row.ladder]
        losses = [row.single - row.measured.mean for row in ladder if row.single is not None]
        if losses:
            words.append(f"up to {max(losses):.2f} dB below packages of one rung")
        beaten = [row.rung for row in ladder if is_beaten(row, of)]
        if beaten:
            words.append(f"beaten by a cheaper rung: {' '.join(beaten)}")
        yield f"{scene} {target}: {'; '.join(words)}"


def is_beaten(row: Row, others: Sequence[Row]) -> bool:
    """Whether a rung with fewer bytes was measured to be at least as good."""
    return any(o.kilobytes < row.kilobytes and o.measured.mean >= row.measured.mean for o in others)


def read_factors(text: str) -> list[float]:
    """Positive numbers with commas. Raises ValueError."""
    factors = [float(part) for part in text.split(",")]
    if not all(0 < factor < math.inf for factor in factors):
        raise ValueError(text)
    return factors


def read_targets(text: str) -> list[str]:
    """PSNR in dB, or DEFAULT, with commas. Raises ValueError."""
    targets = text.split(",")
    read_factors(",".join(target for target in targets if target != DEFAULT) or "1")
    return targets


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", metavar="SCENE[=VIEWS]")
    parser.add_argument(
        "--targets", type=read_targets, default=TARGETS, help=f"dB, or {DEFAULT!r} for no target (default: {TARGETS})"
    )
    parser.add_argument(
        "--single-rungs",
        type=read_factors,
        default=(),
        metavar="FACTORS",
        help="quality factors of packages of one rung",
    )
    parser.add_argument("--draws", type=int, default=12, help="fresh views of a scene (default: 12)")
    parser.add_argument("--seed", type=int, default=1000, help="of their draw (default: 1000)")
    parser.add_argument("--frames", type=int, default=1000, help="most frames measured, evenly spaced (default: 1000)")
    parser.add_argument("--from", dest="views", type=Path, metavar="FILE", help="cameras to measure from instead")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="a field of EncodeSettings")
    parser.add_argument("--packages", type=Path, metavar="DIR", help="keep the packages here")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="write every rung as JSON")
    return parser.parse_args(argv)


def with_fields(settings: EncodeSettings, assignments: Sequence[str]) -> EncodeSettings:
    """Settings with plain fields set from text such as group_frames=50, of the types they have. Raises ConfigError."""
    for assignment in assignments:
        name, _, text = assignment.partition("=")
        kind = type(getattr(settings, name, None))
        if kind not in PLAIN:
            raise ConfigError(f"--set: expected NAME=VALUE with a plain field of EncodeSettings, got {assignment!r}")
        try:
            settings = replace(settings, **{name: PLAIN[kind](text)})
        except (ValueError, KeyError) as error:
            raise ConfigError(f"--set {name}: expected {kind.__name__}, got {text!r}") from error
    return settings


def run(args: argparse.Namespace, folder: Path) -> int:
    """Encode into `folder`, measure, print and write."""
    views = tuple(compared_views(read_cameras(args.views), None)) if args.views else ()
    bench = Bench(with_fields(EncodeSettings(), args.set), args.draws, args.seed, args.frames, views, folder)
    rows: list[Row] = []
    for spec in args.scenes:
        scene, _, cameras = spec.partition("=")
        sequence = open_sequence(scene, views=cameras or None)
        rows += bench_scene(bench, sequence, args.targets, args.single_rungs)
    print("\n".join(table(HEAD, [row.cells() for row in rows])), *verdict(rows), sep="\n")
    if args.output:
        args.output.write_text(json.dumps([asdict(row) | {"off": round(row.off, 3)} for row in rows], indent=1))
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Run everything; gives the exit status."""
    args = parse(argv)
    with tempfile.TemporaryDirectory() as scratch:
        folder: Path = args.packages or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        return run_command("bench_claims", lambda: run(args, folder))


if __name__ == "__main__":
    sys.exit(main())

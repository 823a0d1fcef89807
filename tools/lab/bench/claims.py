"""Do packages have the quality that they claim? Every rung measured again where no decision of the encoder looked.

Each scene is encoded with `--target-psnr` for each target. For every rung the PSNR that the package claims stands
beside that of pictures from views drawn anew from its viewing region, one for each picture, which take turns with the
frames, errors pooled as in a package; and the worst picture that it claims beside the worst one found. Errors are
heavy-tailed: one view close to a large Gaussian may outweigh a hundred. `--held-views` takes views from a file, its
held-out ones if it has any. With `--single-rungs`, packages of one level are encoded at these quality factors, and each
rung is compared with what its bytes buy on the curve of their top rungs. The packages stay in the folder.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from airgs_codec import EncodeSettings, encode, open_package, open_sequence
from airgs_codec._settings import applied
from airgs_codec.encoder.search import PSNR, Goal
from airgs_codec.encoder.settings import DEFAULT_LEVELS
from airgs_codec.errors import AirgsError, ConfigError
from airgs_codec.inspect.sides import compared_views, rung_streams
from airgs_codec.inspect.summary import RungSummary, summarise
from airgs_codec.media.metrics import mse, psnr
from airgs_codec.package.package import Package
from airgs_codec.package.region import draw_views
from airgs_codec.render import Camera, read_cameras, render
from airgs_codec.scene.sequence import GaussianSequence
from tools.lab import Given, Lab, Page, Section, Table, given, required, setting
from tools.lab import Row as PlainRow

DEFAULT = "default"  # in place of a target: the encoder's own quality


@dataclass(frozen=True, slots=True)
class Options:
    """What is encoded and measured."""

    scenes: tuple[str, ...] = required("scenes, each with its cameras or without: SCENE[=VIEWS]")
    targets: tuple[str, ...] = setting(("36", "40", "43"), f"dB, or {DEFAULT} for no target")
    single_rungs: tuple[float, ...] = setting((), "quality factors of packages of one rung")
    pictures: int = setting(64, "pictures that measure a rung, each of its own view")
    seed: int = setting(1000, "of their draw")
    held_views: Path | None = setting(None, "cameras to measure from instead")
    settings: Given = given(EncodeSettings, "settings of the encoder")

    def __post_init__(self) -> None:
        for target in (target for target in self.targets if target != DEFAULT):
            if not target.replace(".", "", 1).isdecimal():
                raise ConfigError(f"--targets: expected dB or {DEFAULT}, got {target}")


def run(options: Options, lab: Lab) -> Page:
    """Encode, measure, compare."""
    views = tuple(compared_views(read_cameras(options.held_views), None)) if options.held_views else ()
    settings = applied(EncodeSettings(), options.settings)
    bench = Bench(settings, options.pictures, options.seed, views, lab.folder, lab.tell)
    rows: list[Row] = []
    for spec in options.scenes:
        scene, _, cameras = spec.partition("=")
        sequence = open_sequence(scene, views=cameras or None)
        for found in bench_scene(bench, sequence, options.targets, options.single_rungs):
            rows += found
    table = Table("claims", [row.plain() for row in rows])
    return Page([Section(". ".join(verdict(rows)) + ".", tables=[table])])


@dataclass(frozen=True, slots=True)
class Measured:
    """PSNR in dB of one rung on fresh views."""

    mean: float  # errors pooled over pictures
    worst: float  # of a picture


@dataclass(frozen=True, slots=True)
class Row:
    """A rung of a package: what was promised and what was found."""

    scene: str
    target: str  # dB, or DEFAULT
    rung: str
    kilobytes: float  # a frame, of everything a viewer fetches
    manifests: float  # of these
    claimed: float | None  # dB; None: the package does not say
    claimed_worst: float | None  # dB, of the worst picture; None likewise
    measured: Measured
    ladder: bool  # whether the package says that no mixture of two other rungs beats it
    single: float | None = None  # dB, of a package of its own with as many bytes; None: not known
    single_media: float | None = None  # the same for as many bytes without manifests

    @property
    def off(self) -> float:
        """By how much more was found than was claimed, in dB; 0 where nothing was."""
        return 0.0 if self.claimed is None else self.measured.mean - self.claimed

    def plain(self) -> PlainRow:
        """As a row of the table."""
        measured = {"measured": self.measured.mean, "worst": self.measured.worst, "off": round(self.off, 3)}
        return asdict(self) | measured


@dataclass(frozen=True, slots=True, eq=False)
class Bench:
    """What all scenes are encoded and measured with."""

    settings: EncodeSettings
    pictures: int  # that measure a rung
    seed: int  # of their views
    views: tuple[Camera, ...]  # measured from, in place of fresh ones; empty: draw them
    folder: Path  # of the packages
    tell: Callable[[str], None] = print  # of targets that are out of reach

    def encode(self, sequence: GaussianSequence, name: str, settings: EncodeSettings, goal: Goal | None) -> Package:
        """The package of a scene. Raises ConfigError for a goal out of reach."""
        folder = self.folder / f"{name}.airgs"
        encode(sequence, folder, settings, goal=goal)
        return open_package(folder)

    def looks(self, package: Package) -> list[Camera]:
        """The cameras that quality is measured from. Raises ConfigError where every view of a region is one camera."""
        region = package.manifest.region
        if not self.views and region.turn == 0 and all(place.reach == 0 for place in region.places):
            raise ConfigError(
                "expected --held-views FILE: the viewing region has no views but those that decisions used"
            )
        return list(self.views) or draw_views(region, self.pictures, self.seed)


def measure(
    package: Package, sequence: GaussianSequence, cameras: Sequence[Camera], pictures: int
) -> dict[str, Measured]:
    """Every rung against the original in so many pictures, or a few more: evenly spaced frames, cameras in turn."""
    step = max(1, len(sequence) // pictures)
    frames = range((len(sequence) - 1) % step // 2, len(sequence), step)
    each = -(-pictures // len(frames))
    streams = rung_streams(package, frames)
    errors: dict[str, list[float]] = {name: [] for name in streams}
    turn = itertools.cycle(cameras)
    for number in frames:
        original = sequence.load([number]).frames[0]
        seen = [(camera, render(original, camera).rgb) for camera in itertools.islice(turn, each)]
        for name, stream in streams.items():
            shown = next(stream)
            errors[name] += [mse(render(shown, camera).rgb, picture) for camera, picture in seen]
    return {name: Measured(round(psnr(sum(e) / len(e)), 3), round(psnr(max(e)), 3)) for name, e in errors.items()}


def rows_of(scene: str, target: str, package: Package, found: dict[str, Measured]) -> list[Row]:
    """The rungs of a package by falling bytes."""
    rungs = summarise(package.manifest, package.manifest_bytes).rungs
    manifests = package.manifest_bytes / package.manifest.frames / 1e3
    rows = []
    for r in sorted(rungs, key=lambda rung: -rung.bytes_per_frame):
        sizes = r.bytes_per_frame / 1e3, manifests
        rows.append(Row(scene, target, _name(r), *sizes, r.psnr, r.worst, found[_name(r)], r.best))
    return rows


def _name(rung: RungSummary) -> str:
    return f"{rung.key}+{rung.state}"


def bench_package(
    bench: Bench, sequence: GaussianSequence, target: str, settings: EncodeSettings, goal: Goal | None = None
) -> list[Row]:
    """Encode and measure one package, named for its scene and `target`. Raises ConfigError for a goal out of reach."""
    scene = sequence.folder.resolve().name
    package = bench.encode(sequence, f"{scene}-{target}", settings, goal)
    found = measure(package, sequence, bench.looks(package), bench.pictures)
    return rows_of(scene, target, package, found)


def bench_scene(
    bench: Bench, sequence: GaussianSequence, targets: Sequence[str], factors: Sequence[float]
) -> Iterator[list[Row]]:
    """All rungs, package by package; a target that the encoder refuses is told of."""
    alone = replace(bench.settings, calibrate="steps", levels=DEFAULT_LEVELS[:1], tiers=(1.0,))
    curve: list[Row] = []
    for factor in factors:
        rows = bench_package(bench, sequence, f"x{factor:g}", replace(alone, quality=factor))
        curve.append(rows[0])
        yield rows[:1]
    for target in targets:
        goal = None if target == DEFAULT else Goal(PSNR, float(target))
        try:
            rows = bench_package(bench, sequence, target, bench.settings, goal)
        except AirgsError as error:
            bench.tell(f"{sequence.folder.name} {target}: {error}")
            continue
        yield [with_single(row, curve) for row in rows]


def with_single(row: Row, curve: Sequence[Row]) -> Row:
    """The row with what its bytes, and its bytes without manifests, buy on a curve of packages of one rung."""
    whole = [(one.kilobytes, one.measured.mean) for one in curve]
    media = [(one.kilobytes - one.manifests, one.measured.mean) for one in curve]
    single, single_media = bought(whole, row.kilobytes), bought(media, row.kilobytes - row.manifests)
    return replace(row, single=single, single_media=single_media)


def bought(curve: Sequence[tuple[float, float]], size: float) -> float | None:
    """PSNR at a size on a curve of (size, PSNR), linear in the logarithm of sizes; None outside the curve."""
    points = sorted(curve)
    if not points or not points[0][0] <= size <= points[-1][0]:
        return None
    sizes, qualities = np.array(points).T
    return round(float(np.interp(np.log(size), np.log(sizes), qualities)), 3)


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
    """Return whether a rung with fewer bytes was measured to be at least as good."""
    return any(o.kilobytes < row.kilobytes and o.measured.mean >= row.measured.mean for o in others)

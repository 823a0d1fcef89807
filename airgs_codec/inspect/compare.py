"""Pictures of Gaussians compared with those of a reference: PSNR, SSIM and CIEDE2000 over views and frames.

Either many streams of frames, such as the rungs of a package, against the original; or two scenes or packages, A and B,
of which A is the reference, with the picture of least PSNR. H x W pixels, 8-bit RGB.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from airgs_codec._arguments import argument, brief
from airgs_codec._report import Table
from airgs_codec.decoder.decode import decode_frames
from airgs_codec.errors import ConfigError
from airgs_codec.inspect.summary import QUALITY, Columns, Row
from airgs_codec.media.image import contact_sheet, to_bytes
from airgs_codec.media.metrics import LOW, Difference, Picture, Quality, pool, psnr
from airgs_codec.package.layout import JSON_NAME
from airgs_codec.package.manifest import quality_of
from airgs_codec.package.package import Package, open_package
from airgs_codec.package.region import CHECKING, background_of, draw_views, from_origin
from airgs_codec.package.tables import Region, RungQuality
from airgs_codec.places.place import is_address, place_at
from airgs_codec.progress import Progress, as_reporter, silent
from airgs_codec.render import Camera
from airgs_codec.render.compare import View, draw_once, draw_still
from airgs_codec.render.compare import compare as compare_views
from airgs_codec.scene.beside import DEFAULT_FPS, SETTINGS_NAME
from airgs_codec.scene.camera import BLACK, UP, Background, cameras_from, orbit_views, with_near_planes
from airgs_codec.scene.formats.form import Axes
from airgs_codec.scene.frames import ZERO, Origin
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence, open_sequence

REGION_VIEWS = 8  # that are drawn from a region
LABEL = 36  # pixels above each picture, for two lines
LEAST_WIDTH = 320  # pixels; smaller pictures are shown with larger pixels, so that labels have room
MOST_GAIN = 64
COMPARED_COLUMNS: Columns = {"rung": ("rung", ""), **QUALITY, "claimed": ("claimed dB", ".2f")}
SIDE_COLUMNS: Columns = {
    "side": ("", ""), "name": ("", ""), "rung": ("rung", ""), "frames": ("frames", "d"), "fps": ("fps", "g"),
    "sh_degree": ("SH degree", ""), "bytes_per_frame": ("bytes a frame", ",.0f"),
    "gaussians": ("Gaussians", lambda rows: " to ".join(f"{count:,}" for count in dict.fromkeys(rows))),
}  # fmt: skip

Measure = TypeVar("Measure")
Scene = Package | GaussianSequence


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """A scene, or a package in one rung, whose frames are read when they are asked for."""

    name: str  # where it is
    rung: str | None  # keyframe quality and level, as Q0+L0; None for a scene
    frames: int
    fps: Fraction | None  # frames a second; None where nothing states them
    sh_degree: int
    bytes_per_frame: float  # of a package what a viewer of the rung fetches: keyframes, deltas and all tables
    origin: Origin  # in the world, that cameras, region and frames are from
    background: Background  # what is seen behind it
    read: Callable[[range], Iterator[Gaussians]]  # frames, repaired; raises SceneError or FormatError
    cameras: tuple[Camera, ...] = ()
    axes: Axes | None = None  # of a scene that says which way is up
    region: Region | None = None
    claimed: Quality | RungQuality | None = None  # of the rung, as the tables have it

    @property
    def label(self) -> str:
        last = Path(self.name).name or self.name
        return f"{last} {self.rung}" if self.rung else last

    def from_origin(self, origin: Origin) -> Side:
        if self.origin == origin:
            return self
        away = np.subtract(origin, self.origin)
        return replace(
            self,
            origin=origin,
            cameras=cameras_from(away, self.cameras),
            region=self.region and from_origin(self.region, away),
            read=lambda frames: (frame.placed(-away, 1.0) for frame in self.read(frames)),
        )


def is_package(scene: Scene | str | Path) -> bool:
    """Return whether a scene, or what a path leads to, is a package. Raises ConfigError, TransportError."""
    if isinstance(scene, str | Path):
        return place_at(scene).open(JSON_NAME) is not None if is_address(scene) else Path(scene, JSON_NAME).is_file()
    return isinstance(scene, Package)


def open_side(
    scene: Scene | str | Path,
    rung: str | None = None,
    *,
    name: str = "",
    bake_fps: Fraction | None = None,
    duration: Fraction | None = None,
) -> Side:
    """Return a scene or package, open or at a place, a package in one `rung`, such as Q0+L0 (default: its top).

    `name`: for people, by default the place. `bake_fps` and `duration` are those of `open_sequence`, for a clip. Raises
    ConfigError for a rung that it does not have, SceneError, FormatError and TransportError for what cannot be opened.
    """
    name = name or str(scene)
    if isinstance(scene, str | Path):
        scene = open_package(scene) if is_package(scene) else open_sequence(scene, bake_fps=bake_fps, duration=duration)
    if isinstance(scene, Package):
        package, m = scene, scene.manifest
        keyframe_quality, _, level = (rung or "Q0+L0").partition("+")
        q, j = m.quality_index(keyframe_quality), m.level_index(level)
        rung, size = f"{m.qualities[q].id}+{m.levels[j].id}", package.manifest_bytes + m.bytes_of(m.rung_files(q, j))
        read = partial(rung_frames, package, level=m.levels[j].id, keyframe_quality=m.qualities[q].id)
        stats, placed = (m.frames, m.fps, m.sh_degree, size / m.frames), (package.origin, background_of(m.region))
        return Side(name, rung, *stats, *placed, read, region=m.region, claimed=quality_of(m, j, q))
    scene = argument(name, scene, GaussianSequence, "an open sequence or package, or the path of one")
    if rung is not None:
        raise ConfigError(f"{name}: expected a package for the rung {rung}, got a scene")
    stated = scene.clip or (scene.folder / SETTINGS_NAME).is_file() or scene.fps != DEFAULT_FPS
    held = [header.bytes for header in scene.headers]  # of frames that are in no file
    total: float = sum(map(_size, set(scene.paths)) if scene.paths[0].exists() else held)
    rates = scene.fps if stated else None, scene.sh_degree, total / len(scene)
    behind, read = (scene.origin, scene.background), partial(frames_of, scene)
    return Side(name, None, len(scene), *rates, *behind, read, scene.cameras, scene.axes)


def _size(path: Path) -> int:
    return sum(p.stat().st_size for p in path.rglob("*") if p.is_file()) if path.is_dir() else path.stat().st_size


def frames_of(sequence: GaussianSequence, numbers: Iterable[int]) -> Iterator[Gaussians]:
    return (sequence.load([number]).frames[0] for number in numbers)


def rung_streams(package: Package, frames: range) -> dict[str, Iterator[Gaussians]]:
    return {rung.name: rung_frames(package, frames, rung.level, rung.keyframe_quality) for rung in package.rungs}


def rung_frames(package: Package, frames: range, level: str, keyframe_quality: str) -> Iterator[Gaussians]:
    """Yield these frames of one rung, at least one, each when it is asked for; `decode_frames` says what is raised."""
    for frame in decode_frames(package, frames[0], frames[-1] + 1, level=level, keyframe_quality=keyframe_quality):
        if frame.number in frames:
            yield frame.gaussians


def comparable(a: Side, b: Side) -> tuple[Side, Side]:
    """Return both from one origin.

    Raises ConfigError where both state frame rates that differ; a single frame has none.
    """
    if a.fps and b.fps and a.fps != b.fps and min(a.frames, b.frames) > 1:
        raise ConfigError(f"{b.name}: expected {float(a.fps):g} frames a second as {a.name}, got {float(b.fps):g}")
    origin = b.origin if a.origin == ZERO else a.origin
    return a.from_origin(origin), b.from_origin(origin)


def left_out(a: Side, b: Side) -> list[str]:
    """Return what one side has that the other lacks, for people."""
    short, long = sorted((a, b), key=lambda side: side.frames)
    extra = range(short.frames, long.frames)
    if not extra:
        return []
    which = f"frame {extra[0]}" if len(extra) == 1 else f"frames {extra[0]} to {extra[-1]}"
    return [f"{which} of {long.name}, which {short.name} does not have"]


def shared_views(a: Side, b: Side, cameras: Sequence[Camera] = (), source: str = "") -> tuple[str, list[Camera]]:
    """Return what both are looked at from, in words too: these cameras, or the held-out ones of A or B, or all.

    Without cameras they are drawn from the viewing region of B or A by the seed for checks, without a package they are
    on an orbit around the first frame of A. Both are seen before the background of A or, where that is black, of B, and
    behind near planes for the size of A.
    """
    first = next(a.read(range(1)))
    sets = [(cameras, source), *((compared_views(side.cameras), side.name) for side in (a, b))]
    views, name = next(((list(some), name) for some, name in sets if some), ([], ""))
    if views:
        held_out = "held-out " * (views[0].split == "test")
        words = f"{len(views)} {held_out}camera{'s' * (len(views) > 1)} of {name}"
    elif side := next((side for side in (b, a) if side.region), None):
        assert side.region
        views = draw_views(side.region, REGION_VIEWS, CHECKING)
        words = f"{len(views)} views drawn from the viewing region of {side.name}, seed {CHECKING}"
    else:
        views = orbit_views(first, up=np.array(a.axes.up) if a.axes else UP)
        words = f"{len(views)} views on an orbit around frame 0 of {a.name}"
    behind = b.background if a.background == BLACK else a.background
    return words, [replace(view, background=behind) for view in with_near_planes(views, first)]


def compared_views(cameras: Sequence[Camera]) -> list[Camera]:
    """Return the cameras that were held out from training, or all if none was."""
    return [camera for camera in cameras if camera.split == "test"] or list(cameras)


def compare_streams(
    streams: Mapping[str, Iterator[Gaussians]],
    reference: Iterator[Gaussians],
    views: Sequence[View],
    measure: Callable[[Picture, Picture], Measure],
    progress: Progress = silent,
) -> dict[str, list[Measure]]:
    """Return what `render.compare.compare` says of every stream against the reference, view by view.

    Views of one frame follow each other; all streams give their frames in that order and no others. Raises SceneError
    for a frame that cannot be read, FormatError for a package that cannot be decoded.
    """
    found: dict[str, list[Measure]] = {name: [] for name in streams}
    frames = [list(seen) for _, seen in itertools.groupby(views, key=lambda view: view[0])]
    for done, seen in enumerate(frames, 1):
        source = draw_once(draw_still(next(reference)))
        for name, stream in streams.items():
            found[name] += compare_views(source, draw_still(next(stream)), seen, measure)
        progress("comparing", done, len(frames))
    return found


def _count_blank(differences: Sequence[Difference]) -> int:
    """Return how many pictures show nothing. Raises ConfigError where none shows anything."""
    blank = sum(difference.blank for difference in differences)
    if blank == len(differences):
        raise ConfigError(f"views: expected some that show something, got {blank} pictures of nothing")
    return blank


def compare_rungs(
    package: Package, original: GaussianSequence, frames: range, cameras: Sequence[Camera], progress: Progress = silent
) -> list[Row]:
    """Return a row for each rung: its quality against the original, and the PSNR that the package claims, or None.

    Raises ConfigError where no picture shows anything, SceneError or FormatError for a frame that cannot be read.
    """
    views = [(number, camera) for number in frames for camera in cameras]
    found = compare_streams(rung_streams(package, frames), frames_of(original, frames), views, Difference.of, progress)
    _count_blank(next(iter(found.values())))
    measured = {name: dataclasses.asdict(pool(some)) for name, some in found.items()}
    return [{"rung": rung.name, **measured[rung.name], "claimed": rung.psnr} for rung in package.rungs]


@dataclass(frozen=True, slots=True, eq=False)
class ComparedPicture:
    frame: int
    camera: Camera
    psnr: float  # dB, of B against A


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """How near B is to A over all pictures of some frames."""

    frames: tuple[int, ...]
    cameras: tuple[str, ...]  # their names
    gaussians: tuple[tuple[int, int], tuple[int, int]]  # of A and of B: fewest and most rows of a frame
    quality: Quality  # of pictures that show something
    pictures: tuple[ComparedPicture, ...]  # all, frame after frame
    blank: int  # of them, which show nothing of either

    __repr__ = brief

    @property
    def lowest(self) -> ComparedPicture:
        return min(self.pictures, key=lambda picture: picture.psnr)


def compare(
    reference: Scene | str | Path,
    compared: Scene | str | Path,
    *,
    rung: str | None = None,
    frames: range | None = None,
    cameras: Sequence[Camera] | None = None,
    progress: Progress | type = silent,
) -> Comparison:
    """Return how near a scene or package is to another, each open or at a path, as `airgs-manifest compare` does.

    `rung`: keyframe quality and level of a package, such as Q1+L2 (default: Q0+L0); of the compared one where both are.
    `frames` are by default all that both have; `cameras` those that `shared_views` finds, from the
    origin of the reference. `progress`: a function, or a class of bars such as tqdm.auto.tqdm. Raises ConfigError for a
    rung or frames that do not exist and for frame rates that differ, and what reading either raises.
    """
    rungs = (None, rung) if is_package(compared) else (rung, None)
    a = open_side(reference, rungs[0], name="reference")
    a, b = comparable(a, open_side(compared, rungs[1], name="compared"))
    both = range(min(a.frames, b.frames))
    numbers = both if frames is None else argument("frames", frames, range, "a range")
    if not numbers or numbers[0] not in both or numbers[-1] not in both:
        raise ConfigError(f"frames: expected some of {both}, got {numbers}")
    if cameras is not None and not cameras:
        raise ConfigError("cameras: expected at least one")
    return compare_two(a, b, numbers, shared_views(a, b, cameras or ())[1], as_reporter(progress))


def compare_two(a: Side, b: Side, frames: range, cameras: Sequence[Camera], progress: Progress = silent) -> Comparison:
    """Return how near B is to A in the same frames and views, at least one of each.

    PSNR is of the mean squared error over all pictures (`media.metrics.PSNR_CAP` where there is none), SSIM and
    CIEDE2000 are means. Raises ConfigError where no picture shows anything, SceneError or FormatError for a frame that
    cannot be read.
    """
    views = [(number, camera) for number in frames for camera in cameras]
    rows: tuple[list[int], list[int]] = ([], [])
    reference, stream = (_counted(side.read(frames), count) for side, count in zip((a, b), rows, strict=True))
    differences = compare_streams({b.name: stream}, reference, views, Difference.of, progress)[b.name]
    blank, names = _count_blank(differences), tuple(camera.name for camera in cameras)
    pictures = tuple(ComparedPicture(*view, psnr(d.mse)) for view, d in zip(views, differences, strict=True))
    counts = (min(rows[0]), max(rows[0])), (min(rows[1]), max(rows[1]))
    return Comparison(tuple(frames), names, counts, pool(differences), pictures, blank)


def _counted(frames: Iterator[Gaussians], rows: list[int]) -> Iterator[Gaussians]:
    for frame in frames:
        rows.append(len(frame))
        yield frame


def comparison_json(a: Side, b: Side, result: Comparison) -> dict[str, Any]:
    lowest = result.lowest
    reference, compared = (
        {"name": side.name, "rung": side.rung, "frames": side.frames, "fps": side.fps and float(side.fps)}
        | {"sh_degree": side.sh_degree, "gaussians": list(rows), "bytes_per_frame": side.bytes_per_frame}
        | {"claimed": side.claimed and dataclasses.asdict(side.claimed)}
        for side, rows in zip((a, b), result.gaussians, strict=True)
    )
    shown: Row = {"frame": lowest.frame, "camera": lowest.camera.name, "psnr": lowest.psnr}
    shown["position"] = lowest.camera.position.tolist()
    record: Row = {"reference": reference, "compared": compared, "frames": list(result.frames)}
    record |= {"cameras": list(result.cameras), "blank": result.blank}
    return record | {"quality": dataclasses.asdict(result.quality), "lowest": shown}


def format_two(record: Mapping[str, Any], views: str, notes: Iterable[str] = ()) -> str:
    """Return `comparison_json` for people; `views` says what the cameras are, `notes` what was left out."""
    q, frames, compared = record["quality"], record["frames"], record["compared"]
    sides = [{"side": "A, the reference"} | record["reference"], {"side": "B"} | compared]
    claim = f" (B's tables claim {compared['claimed']['psnr']:.2f} dB)" if compared["claimed"] else ""
    return "\n".join(
        [
            Table("", sides, SIDE_COLUMNS).to_text(),
            f"{len(frames)} frame{'s' * (len(frames) > 1)} ({frames[0]} to {frames[-1]}) in {views}",
            *(f"left out: {note}" for note in notes),
            *([f"not counted: {record['blank']} pictures that show nothing"] if record["blank"] else []),
            f"PSNR    {q['psnr']:.2f} dB pooled over pictures{claim}",
            f"SSIM    {q['ssim']:.4f}",
            f"ΔE2000  {q['delta_e']:.2f}",
            f"bytes   {compared['bytes_per_frame'] / record['reference']['bytes_per_frame']:.3g} times those of A",
            f"worst   {q['low']:.2f} dB: {100 * LOW:g} % of the pictures have less",
            "lowest  {psnr:.2f} dB, frame {frame}, camera {camera}".format(**record["lowest"]),
        ]
    )


def side_by_side(a: Side, b: Side, seen: ComparedPicture) -> NDArray[np.uint8]:
    """Return A, B and their difference as one camera sees them, with labels above, (LABEL + H, 3 W, 3)."""
    frames = range(seen.frame, seen.frame + 1)
    first, second = (draw_still(next(side.read(frames)))(seen.frame, seen.camera).rgb for side in (a, b))
    difference = np.abs(first - second)
    gain = difference_gain(difference)
    captions = [
        f"A, the reference: {a.label}\nframe {seen.frame}, camera {seen.camera.name}",
        f"B: {b.label}\n{seen.psnr:.2f} dB",
        f"difference x {gain}\nlargest {difference.max():.3f} of 1",
    ]
    pictures = [_with_room(to_bytes(picture)) for picture in (first, second, gain * difference)]
    return contact_sheet(pictures, captions, columns=3)


def difference_gain(difference: NDArray[np.float32]) -> int:
    """Return the power of 2, at most MOST_GAIN, that differences of [0, 1] are multiplied by to be seen."""
    large = float(np.quantile(difference, 0.999))
    return MOST_GAIN if large * MOST_GAIN <= 1 else 2 ** max(0, math.floor(-math.log2(large)))


def _with_room(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a picture below a black band, its pixels repeated until it is LEAST_WIDTH wide."""
    times = math.ceil(LEAST_WIDTH / picture.shape[1])
    return np.pad(picture.repeat(times, axis=0).repeat(times, axis=1), ((LABEL, 0), (0, 0), (0, 0)))

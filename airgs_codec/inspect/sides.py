"""What is compared, and from where: scenes and rungs of packages, whose frames are read when asked for, and views."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from airgs_codec.decoder.decode import decode_frames
from airgs_codec.errors import ConfigError
from airgs_codec.inspect.summary import rung_bytes
from airgs_codec.media.metrics import Quality
from airgs_codec.package.layout import JSON_NAME
from airgs_codec.package.manifest import pooled_quality
from airgs_codec.package.package import Package, open_package
from airgs_codec.package.region import CHECKING, background_of, draw_views, from_origin
from airgs_codec.package.tables import Region
from airgs_codec.places.place import is_address, place_at
from airgs_codec.render import Camera
from airgs_codec.scene.beside import DEFAULT_FPS, SETTINGS_NAME
from airgs_codec.scene.camera import BLACK, UP, Background, cameras_from, orbit_views, with_near_planes
from airgs_codec.scene.formats.form import Axes
from airgs_codec.scene.frames import ZERO, Origin
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence, open_sequence

DRAWS = 8  # views of a region
REGION = "region"  # the split of views that are drawn from the package's region


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    name: str  # where it is
    rung: str | None  # key quality and level, as Q0+L0; None for a scene
    frames: int
    fps: Fraction | None  # frames a second; None where nothing states them
    sh_degree: int
    bytes_per_frame: float  # of a package what a viewer of the rung fetches: keys, states and all tables
    cameras: tuple[Camera, ...]
    region: Region | None
    origin: Origin  # in the world, that cameras, region and frames are from
    background: Background  # what is seen behind it
    axes: Axes | None  # of a scene that says which way is up
    claimed: Quality | None  # of the rung, as the tables have it
    read: Callable[[range], Iterator[Gaussians]]  # frames, repaired; raises SceneError or FormatError

    @property
    def label(self) -> str:
        """The last part of its name, and the rung."""
        last = Path(self.name).name or self.name
        return f"{last} {self.rung}" if self.rung else last


def _at_origin(side: Side, origin: Origin) -> Side:
    if side.origin == origin:
        return side
    away = np.subtract(origin, side.origin)
    return replace(
        side,
        origin=origin,
        cameras=cameras_from(away, side.cameras),
        region=side.region and from_origin(side.region, away),
        read=lambda frames: (frame.placed(-away, 1.0) for frame in side.read(frames)),
    )


def is_package(place: str) -> bool:
    """Whether a package is at a place. Raises ConfigError for an address that cannot be, TransportError."""
    if is_address(place):
        return place_at(place).exists(JSON_NAME)
    return Path(place, JSON_NAME).is_file()


def open_side(
    place: str, rung: str | None = None, *, bake_fps: Fraction | None = None, duration: Fraction | None = None
) -> Side:
    """The scene or package at a place, a package in one `rung`, such as Q0+L0 (default: its top).

    `bake_fps` and `duration` are those of `open_sequence`, for a clip.

    Raises ConfigError for a rung that it does not have, SceneError, FormatError and TransportError for what cannot be
    opened.
    """
    scene = open_package(place) if is_package(place) else open_sequence(place, bake_fps=bake_fps, duration=duration)
    return side_of(scene, place, rung)


def side_of(scene: Package | GaussianSequence, name: str, rung: str | None = None) -> Side:
    """An open scene or package by a name for people. Raises ConfigError for a rung that it does not have."""
    if isinstance(scene, Package):
        return _of_package(name, scene, rung or "Q0+L0")
    if rung is not None:
        raise ConfigError(f"{name}: expected a package for the rung {rung}, got a scene")
    return _of_scene(name, scene)


def _of_package(name: str, package: Package, rung: str) -> Side:
    m = package.manifest
    key_quality, _, level = rung.partition("+")
    q, j = m.quality_index(key_quality), m.level_index(level)
    return Side(
        name=name,
        rung=f"{m.qualities[q].id}+{m.levels[j].id}",
        frames=m.frames,
        fps=m.fps,
        sh_degree=m.sh_degree,
        bytes_per_frame=rung_bytes(m, q, j, package.manifest_bytes) / m.frames,
        cameras=(),
        region=m.region,
        origin=package.origin,
        background=background_of(m.region),
        axes=None,
        claimed=pooled_quality(m, j, q),
        read=lambda frames: rung_frames(package, frames, m.levels[j].id, m.qualities[q].id),
    )


def _of_scene(name: str, sequence: GaussianSequence) -> Side:
    held = [header.bytes for header in sequence.headers]  # of frames that are in no file
    stated = sequence.clip or (sequence.folder / SETTINGS_NAME).is_file() or sequence.fps != DEFAULT_FPS
    return Side(
        name=name,
        rung=None,
        frames=len(sequence),
        fps=sequence.fps if stated else None,
        sh_degree=sequence.sh_degree,
        bytes_per_frame=sum(map(_size, set(sequence.paths)) if sequence.paths[0].exists() else held) / len(sequence),
        cameras=sequence.cameras,
        region=None,
        origin=sequence.origin,
        background=sequence.background,
        axes=sequence.axes,
        claimed=None,
        read=lambda frames: (sequence.load([number]).frames[0] for number in frames),
    )


def _size(path: Path) -> int:
    """Bytes of a file, or of all files of a frame that is a folder."""
    return sum(p.stat().st_size for p in path.rglob("*") if p.is_file()) if path.is_dir() else path.stat().st_size


def rung_streams(
    package: Package, frames: range, level: str | None = None, key_quality: str | None = None
) -> dict[str, Iterator[Gaussians]]:
    """These frames of every rung of a package, or of those of one level or key quality, decoded as they are asked for.

    Raises ConfigError for a level or key quality that the package does not have.
    """
    m = package.manifest
    levels = m.levels if level is None else [m.levels[m.level_index(level)]]
    qualities = m.qualities if key_quality is None else [m.qualities[m.quality_index(key_quality)]]
    return {f"{q.id}+{v.id}": rung_frames(package, frames, v.id, q.id) for q in qualities for v in levels}


def rung_frames(package: Package, frames: range, level: str, key_quality: str) -> Iterator[Gaussians]:
    """These frames of one rung, at least one, decoded as they are asked for; `decode_frames` says what is raised."""
    for frame in decode_frames(package, frames[0], frames[-1] + 1, level=level, key_quality=key_quality):
        if frame.number in frames:
            yield frame.gaussians


def comparable(a: Side, b: Side) -> tuple[Side, Side]:
    """Both from one origin. Raises ConfigError where both state frame rates that differ; a single frame has none."""
    if a.fps and b.fps and a.fps != b.fps and min(a.frames, b.frames) > 1:
        raise ConfigError(f"{b.name}: expected {float(a.fps):g} frames a second as {a.name}, got {float(b.fps):g}")
    origin = b.origin if a.origin == ZERO else a.origin
    return _at_origin(a, origin), _at_origin(b, origin)


def left_out(a: Side, b: Side) -> list[str]:
    """Return what one side has that the other lacks, for people."""
    short, long = sorted((a, b), key=lambda side: side.frames)
    if short.frames == long.frames:
        return []
    extra = range(short.frames, long.frames)
    which = f"frame {extra[0]}" if len(extra) == 1 else f"frames {extra[0]} to {extra[-1]}"
    return [f"{which} of {long.name}, which {short.name} does not have"]


def before_both(a: Side, b: Side, views: Sequence[Camera]) -> list[Camera]:
    """The views before the background of A or, where that is black, of B, their near planes as A is large: both are
    seen before the same one, and behind the same planes.
    """
    behind = b.background if a.background == BLACK else a.background
    return [replace(view, background=behind) for view in with_near_planes(views, next(a.read(range(1))))]


def shared_views(a: Side, b: Side) -> tuple[str, list[Camera]]:
    """Where both are looked at from, and what these views are: the held-out cameras of A or B, or all that it has.

    Without cameras they are drawn from the viewing region of B or A by the seed for checks, without a package they are
    on an orbit around the first frame of A.
    """
    for side in (a, b):
        if side.cameras:
            return described(compared_views(side.cameras, None), side.name)
    for side in (b, a):
        if side.region:
            views = region_views(side.region, DRAWS, CHECKING)
            return f"{len(views)} views drawn from the viewing region of {side.name}, seed {CHECKING}", views
    views = orbit_views(next(a.read(range(1))), up=np.array(a.axes.up) if a.axes else UP)
    return f"{len(views)} views on an orbit around frame 0 of {a.name}", views


def splits_of(cameras: Sequence[Camera]) -> dict[str, int]:
    names = [camera.split for camera in cameras]
    return {name: names.count(name) for name in dict.fromkeys(names)}


def region_views(region: Region, count: int, seed: int) -> list[Camera]:
    """Views drawn from a region, as a split of their own."""
    return [replace(view, split=REGION) for view in draw_views(region, count, seed)]


def compared_views(cameras: Sequence[Camera], split: str | None) -> list[Camera]:
    """The cameras of a split; without one those of REGION and those held out (`test`), or all if none is.

    Raises ConfigError.
    """
    found = splits_of(cameras)
    if split is not None and split not in found:
        raise ConfigError(f"split: expected one of {', '.join(sorted(found))}, got {split!r}")
    wanted = {split} if split else {REGION, "test"} if "test" in found else set(found)
    return [camera for camera in cameras if camera.split in wanted]


def described(views: Sequence[Camera], source: str) -> tuple[str, list[Camera]]:
    """Views that are the held-out cameras of some source, or all of them, after words that say so."""
    kind = f"{'held-out ' * (views[0].split == 'test')}camera{'s' * (len(views) > 1)}"
    return f"{len(views)} {kind} of {source}", list(views)

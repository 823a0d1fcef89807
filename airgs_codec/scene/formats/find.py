"""The files of a scene: one that is named, or the frames in a folder."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from airgs_codec.errors import SceneError
from airgs_codec.scene.formats.clips import SUFFIXES as CLIP_SUFFIXES
from airgs_codec.scene.formats.sog import META_NAME, is_sog_folder
from airgs_codec.scene.formats.table import INRIA, is_frame

_ARCHIVES = (".zip",)  # of a data set rather
POINT_CLOUD = "point_cloud"  # of an INRIA model: point_cloud/iteration_7000/point_cloud.ply
LEVELS = "lod-meta.json"  # of a scene whose folders are pieces of it in levels of detail
INPUT = "input.ply"  # the points that such a model began with


@dataclass(frozen=True, slots=True)
class Found:
    """Frames in display order, and the folder that cameras are looked for in."""

    folder: Path
    paths: tuple[Path, ...]
    alone: bool  # one file, named itself


def find_frames(place: Path) -> Found:
    """The frames at a place: a file, a folder of frames, an INRIA model, a SOG folder or its meta.json.

    Frames of a folder have one suffix; where some are .ply, other files are left alone. Raises SceneError.
    """
    if place.name == META_NAME and is_sog_folder(place.parent):
        place = place.parent
    if place.is_file() or is_sog_folder(place):
        return Found(place.parent, (place,), True)
    if not place.is_dir():
        raise SceneError(f"{place}: expected a folder of frames or a file, got nothing")
    if (place / LEVELS).exists():
        raise SceneError(f"{place}: expected frames, got levels of detail ({LEVELS}): splat-transform converts them")
    paths = sorted(filter(is_frame, place.iterdir()), key=lambda path: (natural_key(path), path.name))
    paths = [path for path in paths if path.suffix.lower() in INRIA.suffixes] or paths
    if {path.name for path in paths} <= {INPUT} and (newest := _newest_iteration(place)):
        return Found(newest.parent, (newest,), False)
    if not paths:
        if clip := next((path for path in sorted(place.iterdir()) if path.suffix.lower() in CLIP_SUFFIXES), None):
            raise SceneError(f"{place}: expected frames, got a clip: give {clip} by its own name")
        raise SceneError(f"{place}: expected at least one .ply frame, or one of another format, got none")
    if len(suffixes := sorted({_kind(path) for path in paths})) > 1:
        raise SceneError(f"{place}: expected frames of one format, got {', '.join(suffixes)}")
    return Found(place, tuple(paths), False)


def has_frames(folder: Path, *, apart_from: Collection[str]) -> bool:
    """Whether frames of some format lie in a folder, or it is one; files of some names do not count."""
    return is_sog_folder(folder) or any(
        is_frame(path) and path.name not in apart_from and path.suffix not in _ARCHIVES for path in folder.iterdir()
    )


def _kind(path: Path) -> str:
    return "folders" if path.is_dir() else path.suffix.lower()


def _newest_iteration(place: Path) -> Path | None:
    """The .ply of the largest iteration of an INRIA model, which is named itself or by its point_cloud/."""
    found = [*place.glob(f"{POINT_CLOUD}/iteration_*/point_cloud.ply"), *place.glob("iteration_*/point_cloud.ply")]
    return max(found, key=lambda path: natural_key(path.parent), default=None)


def natural_key(path: Path) -> list[tuple[int, str]]:
    """Sort key that puts frame2 before frame10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", path.stem) if part]

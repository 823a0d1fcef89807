"""Opening a multi-view scene: the table of formats. To add one, write its module and its row in FORMATS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from airgs_codec.errors import SceneError
from airgs_codec.scene.cameras import llff, panoptic, transforms
from airgs_codec.scene.formats.ply import read_points
from airgs_codec.scene.formats.table import has_frames
from airgs_codec.train.data.colmap import has_colmap, read_colmap
from airgs_codec.train.data.hifi4g import has_hifi4g, read_hifi4g
from airgs_codec.train.data.multiview import MultiviewScene, Points
from airgs_codec.train.data.rig import has_rig, read_rig
from airgs_codec.train.data.transforms import read_panoptic, read_transforms
from airgs_codec.train.data.videos import read_poses_bounds

POINT_FILES = (
    "points3d.ply", "points3D.ply", "points_frame0.ply", "points.ply", "sparse_pc.ply", "points3d.npy",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Format:
    """A kind of multi-view scene on disk."""

    sign: str  # what a folder of this format has, for messages
    recognise: Callable[[Path], bool]
    read: Callable[[Path], MultiviewScene]  # reads no pictures; raises SceneError


def _has(name: str) -> Callable[[Path], bool]:
    return lambda folder: (folder / name).is_file()


FORMATS = (  # the first that recognises a folder reads it
    Format(panoptic.NAME, _has(panoptic.NAME), read_panoptic),
    Format(transforms.NAME, _has(transforms.NAME), read_transforms),
    Format("image_white_undistortion/ (HiFi4G)", has_hifi4g, read_hifi4g),
    Format("COLMAP's sparse/", has_colmap, read_colmap),
    Format(llff.NAME, _has(llff.NAME), read_poses_bounds),
    Format("videos of several cameras", has_rig, read_rig),
)


def is_multiview(folder: Path) -> bool:
    """Whether a folder looks like multi-view video rather than a Gaussian sequence."""
    if not folder.is_dir() or has_frames(folder, apart_from=POINT_FILES):
        return False
    return any(entry.recognise(folder) for entry in FORMATS)


def is_unposed(folder: Path) -> bool:
    """Whether a folder has videos of cameras whose poses must be found first (`train.data.rig.find_poses`)."""
    return has_rig(folder) and not any(entry.recognise(folder) for entry in FORMATS if entry.recognise is not has_rig)


def open_scene(
    folder: Path, *, fps: Fraction | None = None, frames: tuple[int, int | None] = (0, None)
) -> MultiviewScene:
    """The multi-view scene in a folder, or its frames [A, B). Nothing is read from pictures yet.

    `fps`: frames a second, instead of what the scene says.

    Raises SceneError when no format fits, a file is broken or missing, or the frames are not there.
    """
    scene = _read(folder)
    start, stop = frames[0], len(scene) if frames[1] is None else frames[1]
    if not 0 <= start < stop <= len(scene):
        raise SceneError(f"{folder}: expected frames inside 0:{len(scene)}, got {start}:{stop}")
    for number, shots in enumerate(scene.frames):
        if not shots:
            raise SceneError(f"{folder}: expected pictures of frame {number}, got none")
    points = scene.points or (_read_points(folder) if start == 0 else None)
    return replace(scene, frames=scene.frames[start:stop], fps=fps or scene.fps, points=points)


def _read(folder: Path) -> MultiviewScene:
    for entry in FORMATS:
        if entry.recognise(folder):
            return entry.read(folder)
    *others, last = [entry.sign for entry in FORMATS]
    raise SceneError(f"{folder}: expected multi-view pictures with {', '.join(others)} or {last}")


def _read_points(folder: Path) -> Points | None:
    """The cloud of points that lies beside a scene, if there is one."""
    path = next((folder / name for name in POINT_FILES if (folder / name).is_file()), None)
    if path is None:
        return None
    if path.suffix == ".ply":
        return Points(*read_points(path))
    try:
        table = np.load(path, allow_pickle=False).astype(np.float32)
        return Points(table[:, :3], table[:, 3:6] if table.shape[1] >= 6 else None)
    except (OSError, ValueError, IndexError) as error:
        raise SceneError(f"{path}: expected rows of x, y, z [, r, g, b]: {error}") from error

"""Opening a multi-view scene: the table of formats. To add one, write its module and its row in FORMATS.

Those of a JSON file that names pictures with their cameras are read here. nerfstudio's transforms.json has an entry for
each picture, or for each camera where entries name videos. CMU Panoptic, as Dynamic 3D Gaussians has it, is
train_meta.json, pictures in ims/, masks in seg/ that are not 0 where something moves, and points of the first frame in
init_pt_cld.npz.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np

from airgs_codec.errors import SceneError
from airgs_codec.scene.beside import DEFAULT_FPS, exact_number, frame_rate
from airgs_codec.scene.cameras import llff, panoptic, transforms
from airgs_codec.scene.cameras.posed import Posed
from airgs_codec.scene.files import expecting, read_object
from airgs_codec.scene.formats.ply import read_points
from airgs_codec.scene.formats.table import has_frames
from airgs_codec.trainer.data.colmap import has_colmap, has_hifi4g, read_colmap, read_hifi4g
from airgs_codec.trainer.data.multiview import MultiviewScene, Points, Shot, Source, frames_of, in_frames
from airgs_codec.trainer.data.videos import VIDEO_SUFFIXES, CameraFilm, read_poses_bounds, scene_from_films

POINT_FILES = (
    "points3d.ply", "points3D.ply", "points_frame0.ply", "points.ply", "sparse_pc.ply", "points3d.npy",
    "init_pt_cld.npz",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Format:
    """A kind of multi-view scene on disk."""

    sign: str  # what a folder of this format has, for messages
    recognise: Callable[[Path], bool]
    read: Callable[[Path], MultiviewScene]  # reads no pictures; raises SceneError


def read_transforms(folder: Path) -> MultiviewScene:
    """The scene of a transforms.json. Frames are the distinct `time_index`, or the distinct `time` without it.

    Without either, as `ns-process-data` writes it, all pictures are of one frame. `ply_file_path` names its points.

    Raises SceneError.
    """
    path = folder / transforms.NAME
    posed = transforms.read(path)
    fps, points = _frame_rate(path), _named_points(folder, read_object(path).get("ply_file_path"))
    films = {p.camera.name: CameraFilm(_picture_shot(folder, p), folder / p.picture) for p in posed}
    if all(film.path.suffix.lower() in VIDEO_SUFFIXES for film in films.values()):
        return replace(scene_from_films(folder, list(films.values())), points=points)
    return MultiviewScene(folder, fps, in_frames(posed, partial(_picture_shot, folder)), points)


def _named_points(folder: Path, name: object) -> Points | None:
    """The cloud that the file names, in the axes of its cameras; None where it names none. Raises SceneError."""
    if name is None:
        return None
    with expecting(folder / transforms.NAME, "the points of ply_file_path"):
        if not isinstance(name, str) or not (folder / name).is_file():
            raise ValueError(f"got no file {name}")
    return Points(*read_points(folder / name))


def _picture_shot(folder: Path, posed: Posed) -> Shot:
    picture = folder / posed.picture
    source = Source(picture if picture.suffix else picture.with_suffix(".png"))
    return Shot(posed.camera, source, posed.lens, folder / posed.mask if posed.mask else None)


def read_panoptic(folder: Path) -> MultiviewScene:
    """The scene of a train_meta.json, and of the test_meta.json beside it. Raises SceneError."""
    path = folder / panoptic.NAME
    posed = panoptic.read(path)
    return MultiviewScene(folder, _frame_rate(path), in_frames(posed, partial(_masked_shot, folder)))


def _frame_rate(path: Path) -> Fraction:
    """The `fps` of a JSON file. Raises SceneError."""
    with expecting(path, "a frame rate"):
        return frame_rate(str(path), exact_number(str(read_object(path).get("fps", DEFAULT_FPS))))


def _masked_shot(folder: Path, posed: Posed) -> Shot:
    mask = folder / "seg" / Path(posed.picture).with_suffix(".png")
    return Shot(posed.camera, Source(folder / "ims" / posed.picture), None, mask if mask.is_file() else None)


def _has(name: str) -> Callable[[Path], bool]:
    return lambda folder: (folder / name).is_file()


FORMATS = (  # the first that recognises a folder reads it
    Format(panoptic.NAME, _has(panoptic.NAME), read_panoptic),
    Format(transforms.NAME, _has(transforms.NAME), read_transforms),
    Format("image_white_undistortion/ (HiFi4G)", has_hifi4g, read_hifi4g),
    Format("COLMAP's sparse/", has_colmap, read_colmap),
    Format(llff.NAME, _has(llff.NAME), read_poses_bounds),
)


def is_multiview(folder: Path) -> bool:
    """Whether a folder looks like multi-view video rather than a Gaussian sequence."""
    if not folder.is_dir() or has_frames(folder, apart_from=POINT_FILES):
        return False
    return any(entry.recognise(folder) for entry in FORMATS)


def open_scene(
    folder: Path, *, fps: Fraction | None = None, frames: tuple[int, int | None] = (0, None)
) -> MultiviewScene:
    """The multi-view scene in a folder, or its frames [A, B). Nothing is read from pictures yet.

    `fps`: frames a second, instead of what the scene says.

    Raises SceneError when no format fits, a file is broken or missing, or the frames are not there.
    """
    scene = _read(folder)
    for number, shots in enumerate(scene.frames):
        if not shots:
            raise SceneError(f"{folder}: expected pictures of frame {number}, got none")
    start, stop = frames_of(scene, frames)
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
    with expecting(path, "rows of x, y, z [, r, g, b]"), path.open("rb") as file:
        loaded = np.load(file, allow_pickle=False)
        table = (loaded if isinstance(loaded, np.ndarray) else loaded["data"]).astype(np.float32)
        if table.ndim != 2 or table.shape[1] < 3:
            raise ValueError(f"got an array of shape {table.shape}")
        return Points(table[:, :3], table[:, 3:6] if table.shape[1] >= 6 else None)

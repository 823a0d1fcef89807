"""Multi-view scenes of a JSON file that names pictures with their cameras.

nerfstudio's transforms.json has an entry for each picture, or for each camera where entries name videos. CMU Panoptic,
as Dynamic 3D Gaussians has it, is train_meta.json, pictures in ims/, and masks in seg/ that are not 0 where something
moves.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path

from airgs_codec.errors import SceneError
from airgs_codec.scene.cameras import panoptic, transforms
from airgs_codec.scene.cameras.posed import Posed, expecting, read_object
from airgs_codec.scene.formats.ply import read_points
from airgs_codec.scene.sequence_json import DEFAULT_FPS, exact_number, frame_rate
from airgs_codec.train.data.multiview import MultiviewScene, Points, Shot, Source, in_frames
from airgs_codec.train.data.videos import VIDEO_SUFFIXES, CameraFilm, scene_from_films


def read_transforms(folder: Path) -> MultiviewScene:
    """The scene of a transforms.json. Frames are the distinct `time_index`, or the distinct `time` without it.

    Without either, as `ns-process-data` writes it, all pictures are of one frame. `ply_file_path` names its points.

    Raises SceneError.
    """
    path = folder / transforms.NAME
    posed = transforms.read(path)
    fps, points = _frame_rate(path), _points(folder, read_object(path).get("ply_file_path"))
    films = {p.camera.name: CameraFilm(_shot(folder, p), folder / p.picture) for p in posed}
    if all(film.path.suffix.lower() in VIDEO_SUFFIXES for film in films.values()):
        return replace(scene_from_films(folder, list(films.values())), points=points)
    return MultiviewScene(folder, fps, in_frames(posed, partial(_shot, folder)), points)


def _points(folder: Path, name: object) -> Points | None:
    """The cloud that the file names, in the axes of its cameras; None where it names none. Raises SceneError."""
    if name is None:
        return None
    if not isinstance(name, str) or not (folder / name).is_file():
        raise SceneError(f"{folder / transforms.NAME}: expected the points of ply_file_path, got no file {name}")
    return Points(*read_points(folder / name))


def _shot(folder: Path, posed: Posed) -> Shot:
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

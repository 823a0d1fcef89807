"""Multi-view scenes of HiFi4G and DualGS: image_white_undistortion/FRAME/CAM.png and a COLMAP reconstruction.

The reconstruction is in colmap/sparse/0, in the folder of the frames as it is downloaded or moved beside it; its images
are named as the pictures of a frame are. Frames are numbered folders, from any number on. The background is white.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from airgs_codec.errors import SceneError
from airgs_codec.scene.cameras import colmap
from airgs_codec.scene.cameras.posed import Posed
from airgs_codec.scene.formats.table import natural_key
from airgs_codec.scene.sequence_json import DEFAULT_FPS
from airgs_codec.train.data.colmap import read_points3d
from airgs_codec.train.data.multiview import MultiviewScene, Shot, Source
from airgs_codec.train.data.videos import find_pictures

WHITE = (1.0, 1.0, 1.0)
PICTURES = "image_white_undistortion"


def has_hifi4g(folder: Path) -> bool:
    """Whether the folder has the undistorted pictures of such a scene, or is the folder of them."""
    return (folder / PICTURES).is_dir() or (folder.name == PICTURES and _model(folder) is not None)


def read_hifi4g(folder: Path) -> MultiviewScene:
    """The scene; cameras are named by their pictures. Raises SceneError."""
    pictures = folder / PICTURES if (folder / PICTURES).is_dir() else folder
    model = _model(folder) or _model(pictures)
    if model is None:
        raise SceneError(f"{folder}: expected colmap/sparse in it or in {PICTURES}/, got none")
    numbered = [path for path in pictures.iterdir() if path.is_dir() and path.name.isdecimal()]
    if not numbered:
        raise SceneError(f"{pictures}: expected numbered folders, one a frame, got none")
    posed = sorted(colmap.read(model), key=lambda image: natural_key(Path(image.picture)))
    frames = tuple(_frame(path, posed) for path in sorted(numbered, key=natural_key))
    return MultiviewScene(folder, DEFAULT_FPS, frames, read_points3d(model), WHITE)


def _model(folder: Path) -> Path | None:
    return colmap.find_model(folder / "colmap") if (folder / "colmap").is_dir() else None


def _frame(folder: Path, posed: list[Posed]) -> tuple[Shot, ...]:
    """The shots of one frame, in the order of the cameras. Raises SceneError where one has no picture."""
    by_stem = {path.stem: path for path in find_pictures(folder)}
    names = [Path(image.picture).stem for image in posed]
    if missing := [name for name in names if name not in by_stem]:
        raise SceneError(f"{folder}: expected pictures of {len(names)} cameras, got none of {', '.join(missing[:8])}")
    return tuple(
        Shot(replace(image.camera, name=name), Source(by_stem[name]), image.lens)
        for image, name in zip(posed, names, strict=True)
    )

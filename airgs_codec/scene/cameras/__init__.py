"""Cameras from a file or a folder of any form, or from beside a scene; `colmap` and `forms` read those of one form.

To add a form, write its reader and its row here.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from airgs_codec.errors import SceneError
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.cameras import colmap, forms
from airgs_codec.scene.cameras.forms import Posed, Reader, distinct
from airgs_codec.scene.files import BOM, expecting, read_json

BY_MAGIC: tuple[tuple[bytes, Reader], ...] = (
    (forms.SPLATV_MAGIC, forms.read_splatv),
    (forms.NUMPY_MAGIC, forms.read_llff),
)
BY_JSON: tuple[tuple[Callable[[Any], bool], Reader], ...] = (
    (forms.is_transforms, forms.read_transforms),
    (forms.is_panoptic, forms.read_panoptic),
    (forms.is_inria, forms.read_inria),
)
CAMERA_NAMES = (
    forms.TRANSFORMS,
    forms.INRIA,
    "sparse",
    forms.PANOPTIC,
)  # what is looked for beside a scene, in this order
CAMERA_SUFFIXES = (".json", ".splatv", ".npy")  # of files that may have cameras under another name
WORDS = (
    "cameras (transforms.json, INRIA's cameras.json, COLMAP's sparse/, Panoptic's train_meta.json, poses_bounds.npy "
    "or .splatv)"
)


def read_cameras(path: Path) -> list[Camera]:
    """The distinct cameras in a file or a folder of any form, told by its content, in the order of the file.

    A dynamic scene has an entry for each camera and frame: a camera that the file names counts once, with its first
    pose, any other once for each place it was at. A distorted camera is that of its undistorted pictures. `split` is
    "train" where a form marks no held-out cameras, `near` is 0 where it implies none.

    Raises SceneError when there is no file of a known form, several of them in a folder, or one that is broken.
    """
    return distinct(read_posed(path))


def read_posed(path: Path) -> list[Posed]:
    """`read_cameras`, but one for each entry, with its picture. Raises SceneError."""
    found = locate_cameras(path)
    if reader := colmap.read if found.is_dir() else _reader(found):
        return reader(found)
    raise SceneError(f"{found}: expected {WORDS}")


def locate_cameras(path: Path) -> Path:
    """The file of cameras, or the folder of a COLMAP reconstruction, that a file or folder stands for.

    Raises SceneError where a folder has none, or several and none under its usual name.
    """
    if not path.is_dir():
        return path.parent if colmap.is_part(path) else path
    named = [found for name in (*CAMERA_NAMES, forms.LLFF) if (found := _named(path, name))]
    return named[0] if named else colmap.find_model(path) or _only_file(path)


def find_cameras(folder: Path) -> Path | None:
    """The file or folder of cameras that lies beside a scene of .ply frames, or in the INRIA model that it is part of.

    Such a model is a folder with point_cloud/, and the scene is a folder in it or in its point_cloud/.
    """
    inside = folder.resolve()  # "." has no parents of its own
    models = [place for place in inside.parents[:2] if (place / "point_cloud").is_dir()]
    return next((found for place in (folder, *models) for name in CAMERA_NAMES if (found := _named(place, name))), None)


def _named(place: Path, name: str) -> Path | None:
    found = place / name
    if name == "sparse":
        return next((model for model in (found / "0", found) if colmap.is_model(model)), None)
    return found if found.is_file() else None


def _only_file(folder: Path) -> Path:
    files = sorted(file for file in folder.iterdir() if file.suffix in CAMERA_SUFFIXES and file.is_file())
    known = [file for file in files if _reader(file)]
    if len(known) != 1:
        got = f"several: {', '.join(file.name for file in known)}" if known else "none of them"
        raise SceneError(f"{folder}: expected {WORDS}, got {got}")
    return known[0]


def _reader(path: Path) -> Reader | None:
    """Return what reads a file, by its first bytes or by its JSON. Raises SceneError for JSON that is broken."""
    with expecting(path, WORDS), path.open("rb") as file:
        head = file.read(max(len(magic) for magic, _ in BY_MAGIC))
    if known := next((reader for magic, reader in BY_MAGIC if head.startswith(magic)), None):
        return known
    if not head.lstrip().startswith((b"{", b"[", BOM)) and path.suffix != ".json":
        return None
    data = read_json(path)
    return next((reader for fits, reader in BY_JSON if fits(data)), None)

"""Cameras from a file or a folder of any form, or of a scene; `colmap` and `forms` read those of one form.

To add a form, write its reader and its row here.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path

from airgs_codec.errors import SceneError
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.cameras import colmap, forms
from airgs_codec.scene.cameras.forms import Posed, distinct
from airgs_codec.scene.files import SPLATV_MAGIC, expecting, require

Form = tuple[Callable[[Path], Iterable[Posed]], str]  # what reads a file, and what the file is expected to be
BY_MAGIC: tuple[tuple[bytes, Form], ...] = (
    (SPLATV_MAGIC, (forms.read_splatv, "a .splatv header with cameras")),
    (b"\x93NUMPY", (forms.read_llff, "rows of 17 numbers")),
)
BY_JSON: tuple[tuple[set[str], Form], ...] = (  # by names of the object, or of the first one of a list
    ({"frames"}, (forms.read_transforms, f"a nerfstudio {forms.TRANSFORMS}")),
    ({"k", "w2c", "cam_id"}, (forms.read_panoptic, "fn, k, w2c and cam_id of frames and cameras")),
    ({"position", "rotation"}, (forms.read_inria, f"INRIA's {forms.INRIA_CAMERAS}")),
)
CAMERA_NAMES = (forms.TRANSFORMS, forms.INRIA_CAMERAS, "sparse", forms.PANOPTIC)  # looked for in this order
_JSON_FORMS = "transforms.json, INRIA's cameras.json, COLMAP's sparse/, Panoptic's train_meta.json"
CAMERA_FORMS = f"cameras ({_JSON_FORMS}, poses_bounds.npy or .splatv)"


def read_cameras(path: Path) -> list[Camera]:
    """Return the distinct cameras in a file or a folder of any form, known by its content, in the order of the file.

    A camera that the file names counts once, with its first pose, any other once for each pose. A distorted camera is
    that of its undistorted pictures. `split` is "train" where a form marks no held-out cameras, `near` is 0 where it
    implies none. Raises SceneError when there is no file of a known form, or a broken one.
    """
    return distinct(read_posed(path))


def read_posed(path: Path) -> list[Posed]:
    """Return what `read_cameras` does, but one for each entry, with its picture. Raises SceneError."""
    found = locate_cameras(path)
    if found.is_dir():
        return colmap.read(found)
    reader, words = _form_of(found)
    with expecting(found, words):
        posed = list(reader(found))
    require(posed, found, f"expected {words}, at least one camera, got none")
    return posed


def locate_cameras(path: Path) -> Path:
    """Return the file of cameras, or the folder of a COLMAP reconstruction, of a file or folder. Raises SceneError."""
    if not path.is_dir():
        return path.parent if path.name in colmap.PARTS and colmap.is_model(path.parent) else path
    if found := _find_in(path, (*CAMERA_NAMES, forms.LLFF)):
        return found
    raise SceneError(f"{path}: expected {CAMERA_FORMS}, got none of them")


def find_cameras(folder: Path) -> Path | None:
    """Return the file or folder of cameras in the folder of a scene, or in the INRIA model that it is part of.

    Such a model is a folder with point_cloud/, and the scene is a folder in it or in its point_cloud/.
    """
    inside = folder.resolve()  # "." has no parents of its own
    models = [place for place in inside.parents[:2] if (place / "point_cloud").is_dir()]
    return next((found for place in (folder, *models) if (found := _find_in(place, CAMERA_NAMES))), None)


def _find_in(folder: Path, names: Iterable[str]) -> Path | None:
    places = (colmap.find_model(folder) if name == "sparse" else folder / name for name in names)
    return next((place for place in places if place and place.exists()), None)


def _form_of(path: Path) -> Form:
    """Return the form of a file by its first bytes or by its JSON. Raises SceneError for one of no form."""
    with expecting(path, CAMERA_FORMS):
        with path.open("rb") as file:
            head = file.read(8)
        if known := next((form for magic, form in BY_MAGIC if head.startswith(magic)), None):
            return known
        data = json.loads(path.read_text(encoding="utf-8-sig"))
        names = {*(data if isinstance(data, dict) else data[0])}
        if known := next((form for wanted, form in BY_JSON if wanted <= names), None):
            return known
        raise ValueError(f"got {', '.join(map(str, names))}"[:120] or "got nothing")

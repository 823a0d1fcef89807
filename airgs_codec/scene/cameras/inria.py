"""INRIA's cameras.json, as gaussian-splatting (Kerbl et al. 2023) writes it beside its models, and splaTV's .splatv.

A list of {id, img_name, width, height, position, rotation, fx, fy}: the rotation is camera-to-world in OpenCV's axes,
the principal point is the middle of the picture, held-out cameras are not marked.

A .splatv has the magic 0x674b and the length of a JSON header, both 32 bits, the header, then the Gaussians. The header
is a list of chunks; one of type "splat" has `cameras` as cameras.json has them. The usual converter writes one and the
same camera into every file, and the viewer passes it on: that one says nothing of the scene.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec.errors import SceneError
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.cameras.posed import Posed, expect_any, inverse
from airgs_codec.scene.files import Cursor, expecting, read_json

NAME = "cameras.json"
SPLATV_MAGIC = b"\x4b\x67\0\0"
PLACEHOLDER = [-3.0089893469241797, -0.11086489695181866, -3.7527640949141428]  # its position, to the last bit
WORDS = "INRIA's cameras.json"
NEAR = 0.2  # world units: its rasteriser draws nothing nearer (in_frustum in auxiliary.h), so nothing nearer was fitted
MOST_WIDE = 1600  # pixels: wider pictures are trained on at this width by default, though the file has their full size


def fits(data: Any) -> bool:
    """Return whether JSON data is a list of such cameras."""
    return (
        isinstance(data, list) and bool(data) and isinstance(data[0], dict) and {"position", "rotation"} <= {*data[0]}
    )


def read(path: Path) -> list[Posed]:
    """One for each entry, in the order of the file. Raises SceneError."""
    return _posed_from(path, read_json(path))


def read_splatv(path: Path) -> list[Posed]:
    """One for each camera of the header. Raises SceneError."""
    with expecting(path, "a .splatv header with cameras"):
        cursor = Cursor.open(path)
        _, length = cursor.take("II")
        chunks = json.loads(cursor.piece(length))
        cameras = [camera for chunk in chunks for camera in chunk.get("cameras", ())]
        if cameras and all(camera["position"] == PLACEHOLDER for camera in cameras):
            raise SceneError(f"{path}: expected cameras of this scene, got the one that splaTV writes into every file")
    return _posed_from(path, cameras)


def _posed_from(path: Path, data: Any) -> list[Posed]:
    """Read such a list, which the file at `path` holds. Raises SceneError."""
    with expecting(path, WORDS):
        posed = [_posed(entry, number) for number, entry in enumerate(data)]
    return expect_any(posed, path, "at least one camera")


def _posed(entry: dict[str, Any], number: int) -> Posed:
    picture = str(entry.get("img_name", f"view{number:03d}"))
    width, height = int(entry["width"]), int(entry["height"])
    shown = min(width, MOST_WIDE)
    tall = int(height * shown / width)  # cut off, not rounded
    to_world = np.eye(4)
    to_world[:3, :3] = np.asarray(entry["rotation"], np.float64).reshape(3, 3)
    to_world[:3, 3] = np.asarray(entry["position"], np.float64).reshape(3)
    fx, fy = float(entry["fx"]) * shown / width, float(entry["fy"]) * tall / height
    return Posed(Camera(picture, shown, tall, fx, fy, shown / 2, tall / 2, inverse(to_world), near=NEAR), picture)

"""splaTV's .splatv: the magic 0x674b and the length of a JSON header, both 32 bits, the header, then the Gaussians.

The header is a list of chunks; one of type "splat" has `cameras` as INRIA's cameras.json has them. The usual converter
writes one and the same camera into every file, and the viewer passes it on: that one says nothing of the scene.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from airgs_codec.errors import SceneError
from airgs_codec.scene.cameras import inria
from airgs_codec.scene.cameras.binary import Cursor
from airgs_codec.scene.cameras.posed import Posed, expecting

MAGIC = b"\x4b\x67\0\0"
PLACEHOLDER = [-3.0089893469241797, -0.11086489695181866, -3.7527640949141428]  # its position, to the last bit


def read(path: Path) -> list[Posed]:
    """One for each camera of the header. Raises SceneError."""
    with expecting(path, "a .splatv header with cameras"):
        cursor = Cursor.open(path)
        _, length = cursor.take("II")
        chunks = json.loads(cursor.piece(length))
        cameras = [camera for chunk in chunks for camera in chunk.get("cameras", ())]
        if cameras and all(_is_placeholder(camera) for camera in cameras):
            raise SceneError(f"{path}: expected cameras of this scene, got the one that splaTV writes into every file")
    return inria.posed_from(path, cameras)


def _is_placeholder(camera: dict[str, Any]) -> bool:
    return camera["position"] == PLACEHOLDER

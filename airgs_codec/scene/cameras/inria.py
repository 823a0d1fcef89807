"""INRIA's cameras.json, as gaussian-splatting (Kerbl et al. 2023) writes it beside its models; splaTV has the same.

A list of {id, img_name, width, height, position, rotation, fx, fy}: the rotation is camera-to-world in OpenCV's axes,
the principal point is the middle of the picture, held-out cameras are not marked.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec.errors import SceneError
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.cameras.posed import Posed, expecting, inverse, read_json

NAME = "cameras.json"
WORDS = "INRIA's cameras.json"
NEAR = 0.2  # world units: its rasteriser draws nothing nearer (in_frustum in auxiliary.h), so nothing nearer was fitted
MOST_WIDE = 1600  # pixels: wider pictures are trained on at this width by default, though the file has their full size


def fits(data: Any) -> bool:
    """Whether JSON data is a list of such cameras."""
    return (
        isinstance(data, list) and bool(data) and isinstance(data[0], dict) and {"position", "rotation"} <= {*data[0]}
    )


def read(path: Path) -> list[Posed]:
    """One for each entry, in the order of the file. Raises SceneError."""
    return posed_from(path, read_json(path))


def posed_from(path: Path, data: Any) -> list[Posed]:
    """`read` of such a list that the file at `path` holds."""
    with expecting(path, WORDS):
        posed = [_posed(entry, number) for number, entry in enumerate(data)]
    if not posed:
        raise SceneError(f"{path}: expected at least one camera, got none")
    return posed


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

"""A picture of what cameras see of a scene, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import ConfigError
from airgs_codec.media.image import contact_sheet, to_bytes, write_png
from airgs_codec.render import Camera, Render, render_views
from airgs_codec.scene.camera import resized
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.repair import repair

SIDE = 240  # pixels, of the square that each picture fits into; larger ones are made smaller


def write_contact_sheet(path: Path, frame: Gaussians, cameras: Sequence[Camera], notes: Sequence[str] = ()) -> None:
    """Write a PNG of `frame` as each camera sees it under its name, its position and its note, if any.

    Raises SceneError when the frame has no finite row; ConfigError without a camera, or when the file cannot be
    written.
    """
    if not cameras:
        raise ConfigError(f"{path}: expected at least one camera for a contact sheet, got none")
    usable = repair([frame], path.name).frames[0]
    more = [f"\n{note}" for note in notes] + [""] * (len(cameras) - len(notes))
    captions = [f"{c.name}  ({_place(c)}){note}" for c, note in zip(cameras, more, strict=True)]
    pictures = render_views(usable, [resized(c, SIDE / max(c.width, c.height)) for c in cameras])
    sheet = contact_sheet([_tile(picture) for picture in pictures], captions)
    try:
        write_png(path, sheet)
    except OSError as error:
        raise ConfigError(f"{path}: cannot write the contact sheet: {error}") from error


def _place(camera: Camera) -> str:
    return ", ".join(f"{coordinate:.3g}" for coordinate in camera.position)


def _tile(picture: Render) -> NDArray[np.uint8]:
    """(SIDE, SIDE, 3) a picture in the middle of black."""
    height, width = picture.transmittance.shape
    tile = np.zeros((SIDE, SIDE, 3), np.uint8)
    top, left = (SIDE - height) // 2, (SIDE - width) // 2
    tile[top : top + height, left : left + width] = to_bytes(picture.rgb)
    return tile

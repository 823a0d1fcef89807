"""A multi-view scene whose pictures are drawn, when they are asked for, from Gaussians."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.media.image import to_bytes
from airgs_codec.render.backend import Loaded, Renderer
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.sequence import GaussianSequence
from airgs_codec.train.data.multiview import MultiviewScene, Shot


class Drawing:
    """What draws the frames of a sequence; the last one stays loaded for its further views."""

    def __init__(self, sequence: GaussianSequence, renderer: Renderer) -> None:
        self.load = lru_cache(maxsize=1)(lambda frame: renderer.load(sequence.load([frame]).frames[0]))

    def draw(self, frame: int, camera: Camera) -> NDArray[np.uint8]:
        """(H, W, 3) what a camera sees of a frame."""
        loaded: Loaded = self.load(frame)
        return to_bytes(loaded.draw(camera).rgb)


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """A picture of a frame, in place of a `Source`."""

    path: Path  # of the frame
    frame: int
    camera: Camera
    drawing: Drawing

    def read(self, size: tuple[int, int]) -> NDArray[np.uint8]:
        """(H, W, 3) the picture, which has the size of its camera. Raises SceneError for a broken frame."""
        return self.drawing.draw(self.frame, self.camera)

    def __str__(self) -> str:
        """Name the place in a message."""
        return f"{self.path} frame {self.frame}"


def drawn_scene(sequence: GaussianSequence, cameras: Sequence[Camera], renderer: Renderer) -> MultiviewScene:
    """The scene that cameras see of a sequence."""
    drawing = Drawing(sequence, renderer)
    frames = (
        tuple(Shot(camera, Drawn(path, frame, camera, drawing)) for camera in cameras)
        for frame, path in enumerate(sequence.paths)
    )
    return MultiviewScene(sequence.folder, sequence.fps, tuple(frames), None, sequence.background, sequence)

"""A multi-view scene whose pictures are drawn, when they are asked for, from Gaussians."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.media.image import to_bytes
from airgs_codec.render.backend import Loaded, Renderer
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.sequence import GaussianSequence
from airgs_codec.trainer.data.multiview import MultiviewScene, Shot


class Drawing:
    """What draws the frames of a sequence; the last one stays loaded for its further views. It can be pickled."""

    def __init__(self, sequence: GaussianSequence, renderer: Renderer) -> None:
        self.sequence, self.renderer = sequence, renderer
        self._loaded: tuple[int, Loaded] | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        return Drawing, (self.sequence, self.renderer)

    def draw(self, frame: int, camera: Camera) -> NDArray[np.uint8]:
        """(H, W, 3) what a camera sees of a frame. Raises SceneError for a broken one."""
        if self._loaded is None or self._loaded[0] != frame:
            self._loaded = frame, self.renderer.load(self.sequence.load([frame]).frames[0])
        return to_bytes(self._loaded[1].draw(camera).rgb)


@dataclass(frozen=True, slots=True)
class Drawn:
    """A picture of a frame, in place of a `Source`."""

    frame: int
    content: str  # names what is in the frame; the camera that sees it is named by the shot
    camera: Camera
    drawing: Drawing

    @property
    def files(self) -> tuple[Path, ...]:
        """None: the content is known."""
        return ()

    def read(self, size: tuple[int, int]) -> NDArray[np.uint8]:
        """(H, W, 3) the picture, which has the size of its camera. Raises SceneError for a broken frame."""
        return self.drawing.draw(self.frame, self.camera)

    def check(self, size: tuple[int, int]) -> None:
        """Nothing: there is one, of the size of its camera."""

    def __str__(self) -> str:
        """Name the place in a message."""
        return f"{self.drawing.sequence.paths[self.frame]} frame {self.frame}"


def drawn_scene(
    sequence: GaussianSequence, names: Sequence[str], cameras: Sequence[Camera], renderer: Renderer
) -> MultiviewScene:
    """The scene that cameras see of a sequence; `names` are those of the contents of its frames."""
    drawing = Drawing(sequence, renderer)
    frames = (
        tuple(Shot(camera, Drawn(frame, name, camera, drawing)) for camera in cameras)
        for frame, name in enumerate(names)
    )
    return MultiviewScene(sequence.folder, sequence.fps, tuple(frames), None, sequence.background, sequence)

"""The pictures of a multi-view scene as they are trained on: undistorted, shrunk, masked, exposed alike.

Pictures are read when they are asked for, and the last ones used are kept. H x W pixels.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.media.image import read_mask, resize, undistort
from airgs_codec.scene.camera import Camera
from airgs_codec.train.data.multiview import MultiviewScene, Shot
from airgs_codec.train.loss.target import Exposure, Target, exposed_alike
from airgs_codec.train.settings import TrainSettings

CACHE_BYTES = 1 << 30


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A picture and the camera that took it, at the size that is trained on."""

    camera: Camera
    target: Target


class Pictures:
    """The pictures of a scene at training size."""

    def __init__(
        self,
        scene: MultiviewScene,
        *,
        max_size: int | None = None,
        foreground: bool = False,
        exposure: Exposure | None = None,
        cache_bytes: int = CACHE_BYTES,
    ) -> None:
        """Read nothing yet.

        `max_size`: longest side in pixels; None keeps the size. `foreground`: what the masks leave out becomes black.
        `exposure`: pictures of these cameras come as the average camera would have exposed them. `cache_bytes`: most
        memory that pictures in use may hold together.
        """
        self._scene = scene
        self._max_size = max_size
        self._foreground = foreground
        self._exposure = exposure or {}
        self._cache_bytes = cache_bytes
        self._kept: OrderedDict[tuple[int, int], View] = OrderedDict()

    def with_exposure(self, exposure: Exposure) -> Pictures:
        """The same pictures as the average camera would have exposed them."""
        return Pictures(
            self._scene,
            max_size=self._max_size,
            foreground=self._foreground,
            exposure=exposure,
            cache_bytes=self._cache_bytes,
        )

    def train(self, frame: int) -> list[View]:
        """The training views of a frame. Raises SceneError for a picture that cannot be read or has a wrong size."""
        return self._split(frame, held_out=False)

    def held_out(self, frame: int) -> list[View]:
        """The held-out views of a frame. Raises SceneError as `train` does."""
        return self._split(frame, held_out=True)

    def cameras(self) -> list[Camera]:
        """The cameras of the first frame at training size."""
        return [self._scaled(camera) for camera in self._scene.cameras]

    def _split(self, frame: int, held_out: bool) -> list[View]:
        shots = self._scene.frames[frame]
        return [self._view(frame, i) for i, s in enumerate(shots) if s.camera.held_out == held_out]

    def _view(self, frame: int, index: int) -> View:
        key = (frame, index)
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        shot = self._scene.frames[frame][index]
        view = View(self._scaled(shot.camera), Target(self._load(shot)))
        self._kept[key] = view
        while len(self._kept) > 1 and sum(v.target.nbytes for v in self._kept.values()) > self._cache_bytes:
            self._kept.popitem(last=False)
        return view

    def _scaled(self, camera: Camera) -> Camera:
        longest = max(camera.width, camera.height)
        if self._max_size is None or longest <= self._max_size:
            return camera
        factor = self._max_size / longest
        width, height = max(1, round(camera.width * factor)), max(1, round(camera.height * factor))
        x, y = width / camera.width, height / camera.height
        focal, centre = (camera.fx * x, camera.fy * y), (camera.cx * x, camera.cy * y)
        return replace(camera, width=width, height=height, fx=focal[0], fy=focal[1], cx=centre[0], cy=centre[1])

    def _load(self, shot: Shot) -> NDArray[np.float32]:
        size = shot.lens.size if shot.lens else (shot.camera.width, shot.camera.height)
        rgb = _as_colours(shot, size)
        if self._foreground:
            if shot.mask is None:
                raise SceneError(f"{shot.source.where()}: expected a mask of the foreground, the scene has none")
            rgb = rgb * read_mask(shot.mask, size)[..., None]
        if shot.lens:
            rgb = undistort(rgb, shot.lens)
        camera = self._scaled(shot.camera)
        rgb = resize(rgb, camera.width, camera.height)
        return exposed_alike(rgb, self._exposure[camera.name]) if camera.name in self._exposure else rgb


def pictures_for(scene: MultiviewScene, settings: TrainSettings) -> Pictures:
    """The pictures that a run with these settings is trained on."""
    return Pictures(scene, max_size=settings.max_size, foreground=settings.foreground)


def _as_colours(shot: Shot, size: tuple[int, int]) -> NDArray[np.float32]:
    """(H, W, 3) colours, 0..1; what is transparent is black, as the renderer's background is."""
    data = shot.source.read()
    if data.shape[1::-1] != size:
        got = f"{data.shape[1]}x{data.shape[0]}"
        raise SceneError(f"{shot.source.where()}: expected a picture of {size[0]}x{size[1]}, got {got}")
    rgb = data[..., :3].astype(np.float32) / np.float32(255)
    if data.shape[2] == 4:
        rgb *= data[..., 3:].astype(np.float32) / np.float32(255)
    return rgb

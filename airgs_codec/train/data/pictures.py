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
from airgs_codec.render.cpu import Redraw
from airgs_codec.scene.camera import Background, Camera
from airgs_codec.train.data.multiview import MultiviewScene, Shot
from airgs_codec.train.loss.target import Exposure, Target, exposed_alike
from airgs_codec.train.settings import RANDOM, TrainSettings, named_background

CACHE_BYTES = 1 << 30


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A picture and the camera that took it, at the size that is trained on."""

    camera: Camera
    target: Target
    redraw: Redraw | None = None  # None: the whole picture is drawn

    def before(self, background: Background) -> View:
        """The same before another background. Raises ValueError where the picture has no alpha."""
        target = self.target.before(self.camera.background, background)
        return View(replace(self.camera, background=background), target)


class Pictures:
    """The pictures of a scene at training size."""

    def __init__(
        self,
        scene: MultiviewScene,
        *,
        max_size: int | None = None,
        foreground: bool = False,
        background: str | None = None,
        exposure: Exposure | None = None,
        cache_bytes: int = CACHE_BYTES,
    ) -> None:
        """Read nothing yet.

        `max_size`: longest side in pixels; None keeps the size. `foreground`: what the masks leave out becomes
        background. `background`: as in `TrainSettings`; pictures and cameras have the one of the scene unless it names
        a colour, and with RANDOM pictures must have alpha.
        `exposure`: pictures of these cameras come as the average camera would have exposed them. `cache_bytes`: most
        memory that pictures in use may hold together.
        """
        self._scene = scene
        self._max_size = max_size
        self._foreground = foreground
        self._choice = background
        self.background = named_background(background) or scene.background
        self._exposure = exposure or {}
        self._cache_bytes = cache_bytes
        self._kept: OrderedDict[tuple[int, int], View] = OrderedDict()

    def with_exposure(self, exposure: Exposure) -> Pictures:
        """The same pictures as the average camera would have exposed them."""
        return Pictures(
            self._scene,
            max_size=self._max_size,
            foreground=self._foreground,
            background=self._choice,
            exposure=exposure,
            cache_bytes=self._cache_bytes,
        )

    def train(self, frame: int) -> list[View]:
        """The training views of a frame. Raises SceneError for a picture that cannot be read or has a wrong size."""
        return self._split(frame, held_out=False)

    def held_out(self, frame: int) -> list[View]:
        """The held-out views of a frame. Raises SceneError as `train` does."""
        return self._split(frame, held_out=True)

    def view(self, frame: int, index: int) -> View:
        """The view of a camera, counted as the scene does. Raises SceneError as `train` does."""
        return self._view(frame, index)

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
        view = View(self._scaled(shot.camera), self._load(shot))
        self._kept[key] = view
        while len(self._kept) > 1 and sum(v.target.nbytes for v in self._kept.values()) > self._cache_bytes:
            self._kept.popitem(last=False)
        return view

    def _scaled(self, camera: Camera) -> Camera:
        camera = replace(camera, background=self.background)
        longest = max(camera.width, camera.height)
        if self._max_size is None or longest <= self._max_size:
            return camera
        factor = self._max_size / longest
        width, height = max(1, round(camera.width * factor)), max(1, round(camera.height * factor))
        x, y = width / camera.width, height / camera.height
        focal, centre = (camera.fx * x, camera.fy * y), (camera.cx * x, camera.cy * y)
        return replace(camera, width=width, height=height, fx=focal[0], fy=focal[1], cx=centre[0], cy=centre[1])

    def _load(self, shot: Shot) -> Target:
        size = shot.lens.size if shot.lens else (shot.camera.width, shot.camera.height)
        rgb, alpha = _as_colours(shot, size)
        if self._foreground:
            if shot.mask is None:
                raise SceneError(f"{shot.source.where()}: expected a mask of the foreground, the scene has none")
            mask = read_mask(shot.mask, size)
            alpha = mask if alpha is None else alpha * mask
        if alpha is None:
            if self._choice == RANDOM:
                raise SceneError(f"{shot.source.where()}: expected alpha for random backgrounds, got an opaque picture")
            return Target(self._fitted(rgb, shot))
        clear = 1 - alpha[..., None]
        whole = np.concatenate([alpha[..., None] * rgb + clear * np.array(self.background, np.float32), clear], axis=2)
        fitted = self._fitted(whole, shot)
        return Target(fitted[..., :3], np.ascontiguousarray(fitted[..., 3]))

    def _fitted(self, picture: NDArray[np.float32], shot: Shot) -> NDArray[np.float32]:
        """A picture (H, W, C) without its lens, at training size, its colours exposed alike."""
        if shot.lens:
            picture = undistort(picture, shot.lens)
        camera = self._scaled(shot.camera)
        picture = resize(picture, camera.width, camera.height)
        if camera.name in self._exposure:
            alike = exposed_alike(picture[..., :3], self._exposure[camera.name])
            picture = np.concatenate([alike, picture[..., 3:]], axis=2)
        return picture


def pictures_for(scene: MultiviewScene, settings: TrainSettings) -> Pictures:
    """The pictures that a run with these settings is trained on."""
    return Pictures(scene, max_size=settings.max_size, foreground=settings.foreground, background=settings.background)


def _as_colours(shot: Shot, size: tuple[int, int]) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
    """(H, W, 3) colours and (H, W) alpha, 0..1; None without alpha."""
    data = shot.source.read()
    if data.shape[1::-1] != size:
        got = f"{data.shape[1]}x{data.shape[0]}"
        raise SceneError(f"{shot.source.where()}: expected a picture of {size[0]}x{size[1]}, got {got}")
    values = data.astype(np.float32) / np.float32(255)
    return values[..., :3], values[..., 3] if data.shape[2] == 4 else None

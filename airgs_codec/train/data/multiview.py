"""Multi-view video: what each camera saw at each frame. Pictures are read when they are asked for.

Cameras follow `render.camera`: OpenCV convention, x right, y down, z forward, pixel centres at +0.5; lengths in the
units of the scene.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.media.image import Lens, read_mask, read_picture, resize, undistort
from airgs_codec.scene.camera import Camera
from airgs_codec.train.loss.target import Exposure, Target, exposed_alike

HELD_OUT_SHARE = 8  # one camera in so many, where a scene names none
CACHE_BYTES = 1 << 30


class Source(Protocol):
    """Where a picture comes from."""

    def read(self) -> NDArray[np.uint8]:
        """(H, W, 3) RGB or (H, W, 4) with alpha. Raises SceneError."""

    def where(self) -> str:
        """For messages."""


@dataclass(frozen=True, slots=True)
class PictureFile:
    """A picture of its own."""

    path: Path

    def read(self) -> NDArray[np.uint8]:
        """As `Source`."""
        return read_picture(self.path)

    def where(self) -> str:
        """As `Source`."""
        return str(self.path)


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """What one camera saw at one frame."""

    camera: Camera  # of the undistorted picture at full size
    source: Source
    lens: Lens | None = None  # None: a pinhole camera already
    mask: Path | None = None  # foreground where it is not 0


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """A cloud to start from."""

    positions: NDArray[np.float32]  # (P, 3) world units
    colours: NDArray[np.float32] | None  # (P, 3) RGB of [0, 1]


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A multi-view scene of one or more frames."""

    path: Path
    fps: Fraction
    frames: tuple[tuple[Shot, ...], ...]
    points: Points | None = None

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def cameras(self) -> list[Camera]:
        """Of the first frame."""
        return [shot.camera for shot in self.frames[0]]


def with_near(scene: Scene, near: float) -> Scene:
    """`scene` with Gaussians nearer than `near` world units hidden from every camera."""

    def changed(shot: Shot) -> Shot:
        return replace(shot, camera=replace(shot.camera, near=near))

    return replace(scene, frames=tuple(tuple(changed(s) for s in shots) for shots in scene.frames))


def with_held_out(scene: Scene, names: Sequence[str] | None) -> Scene:
    """`scene` with the cameras `names` held out; None: those it marks itself, else one in HELD_OUT_SHARE.

    Raises SceneError for a name that no camera has, or when no camera is left to train on.
    """
    known = [shot.camera.name for shot in scene.frames[0]]
    if names is None:
        if any(shot.camera.split == "test" for shot in scene.frames[0]):
            return scene
        count = len(known) // HELD_OUT_SHARE  # middles of equal parts: views between others, not at an end
        names = [known[(2 * i + 1) * len(known) // (2 * count)] for i in range(count)]
    if unknown := sorted(set(names) - set(known)):
        raise SceneError(f"{scene.path}: no camera {', '.join(unknown)}; there are {', '.join(known)}")
    if not set(known) - set(names):
        raise SceneError(f"{scene.path}: expected cameras to train on, all {len(known)} are held out")

    def marked(shot: Shot) -> Shot:
        return replace(shot, camera=replace(shot.camera, split="test" if shot.camera.name in names else "train"))

    return replace(scene, frames=tuple(tuple(marked(s) for s in shots) for shots in scene.frames))


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A picture and the camera it was taken by, at the size that is trained on."""

    camera: Camera
    target: Target


class Pictures:
    """Pictures of a scene at training size, read on demand; the last ones used are kept."""

    def __init__(self, scene: Scene, max_size: int | None, foreground: bool, cache_bytes: int = CACHE_BYTES) -> None:
        """`max_size`: longest side in pixels. `foreground`: what the masks leave out is black."""
        self._scene = scene
        self._max_size = max_size
        self._foreground = foreground
        self._room = cache_bytes
        self._exposure: Exposure = {}
        self._kept: OrderedDict[tuple[int, int], View] = OrderedDict()

    def train(self, frame: int) -> list[View]:
        """Training views of a frame. Raises SceneError for a picture that cannot be read or has the wrong size."""
        return self._split(frame, held_out=False)

    def held_out(self, frame: int) -> list[View]:
        """The others."""
        return self._split(frame, held_out=True)

    def expose_alike(self, exposure: Exposure) -> None:
        """From now on, pictures of these cameras come as the average camera would have exposed them."""
        self._exposure = exposure
        self._kept.clear()

    def cameras(self) -> list[Camera]:
        """Cameras of the first frame at training size."""
        return [self._scaled(shot.camera) for shot in self._scene.frames[0]]

    def _split(self, frame: int, held_out: bool) -> list[View]:
        shots = self._scene.frames[frame]
        return [self._view(frame, i) for i, s in enumerate(shots) if (s.camera.split == "test") == held_out]

    def _view(self, frame: int, index: int) -> View:
        key = (frame, index)
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        shot = self._scene.frames[frame][index]
        view = View(self._scaled(shot.camera), Target(self._load(shot)))
        self._kept[key] = view
        while len(self._kept) > 1 and sum(v.target.nbytes for v in self._kept.values()) > self._room:
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
        data = shot.source.read()
        size = shot.lens.size if shot.lens else (shot.camera.width, shot.camera.height)
        if data.shape[1::-1] != size:
            got = f"{data.shape[1]}x{data.shape[0]}"
            raise SceneError(f"{shot.source.where()}: expected a picture of {size[0]}x{size[1]}, got {got}")
        rgb = data[..., :3].astype(np.float32) / np.float32(255)
        if data.shape[2] == 4:  # transparent is black, as the renderer's background
            rgb *= data[..., 3:].astype(np.float32) / np.float32(255)
        if self._foreground:
            if shot.mask is None:
                raise SceneError(f"{shot.source.where()}: expected a mask of the foreground, the scene has none")
            rgb = rgb * read_mask(shot.mask, size)[..., None]
        if shot.lens:
            rgb = undistort(rgb, shot.lens)
        camera = self._scaled(shot.camera)
        rgb = resize(rgb, camera.width, camera.height)
        return exposed_alike(rgb, self._exposure[camera.name]) if camera.name in self._exposure else rgb

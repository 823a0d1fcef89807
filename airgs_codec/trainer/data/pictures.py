"""The pictures of a multi-view scene as they are trained on: undistorted, shrunk, masked, exposed alike.

Pictures are read when they are asked for and buffered in 8 bits at training size; targets in float32 are made of them
when they are needed. Of both, those used last are buffered, so that memory is bounded however many pictures there are.
H x W pixels, n = 3 W interleaved samples a row.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.media.image import check_picture, read_mask, resize, to_bytes, to_floats, undistort
from airgs_codec.render.cpu import Redraw
from airgs_codec.scene.camera import Background, Camera, with_pixels
from airgs_codec.trainer.data.multiview import MultiviewScene, Shot
from airgs_codec.trainer.settings import OFF, RANDOM, TrainSettings, named_background

PICTURE_BYTES = 1 << 30  # of pictures in 8 bits: 40 in 4K, or 170 in 1080p
TARGET_BYTES = 2 << 30  # of targets: 7 in 4K, or 28 in 1080p

_Key = tuple[int, int]  # frame, and place of the shot in it


class Sized(Protocol):
    """What takes memory, in bytes."""

    @property
    def nbytes(self) -> int: ...


Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value", bound=Sized)


class Recent(Generic[Key, Value]):
    """Values that are made when they are asked for, of which those used last stay in memory."""

    def __init__(self, make: Callable[[Key], Value], most: int) -> None:
        """`most`: bytes that stay together; the value that was asked for last stays whatever it takes."""
        self._make = make
        self._most = most
        self._values: OrderedDict[Key, Value] = OrderedDict()

    @property
    def nbytes(self) -> int:
        return sum(value.nbytes for value in self._values.values())

    def get(self, key: Key) -> Value:
        """The value of a key. Raises what making it raises."""
        if key not in self._values:
            return self.put(key, self._make(key))
        self._values.move_to_end(key)
        return self._values[key]

    def put(self, key: Key, value: Value) -> Value:
        """Hold a value that is known already, and return it."""
        self._values[key] = value
        held = self.nbytes
        while held > self._most and len(self._values) > 1:
            held -= self._values.popitem(last=False)[1].nbytes
        return value


class Picture(Protocol):
    """A picture that is at hand, or can be."""

    def target(self) -> Target:
        """The picture in float32. Raises SceneError where it cannot be read."""


@dataclass(frozen=True, slots=True, eq=False)
class Buffered:
    """A picture that is made when it is asked for."""

    buffer: Recent[Any, Target]
    key: Hashable

    def target(self) -> Target:
        return self.buffer.get(self.key)


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A picture and the camera that took it, at the size that is trained on."""

    camera: Camera
    picture: Picture
    redraw: Redraw | None = None  # None: the whole picture is drawn
    after: float = 0.0  # as in `Shot`

    @property
    def target(self) -> Target:
        """The picture in float32; hold it no longer than it is needed. Raises SceneError where it cannot be read."""
        return self.picture.target()

    def before(self, background: Background) -> View:
        """The same before another background. Raises ValueError where the picture has no alpha."""
        target = self.target.before(self.camera.background, background)
        return View(replace(self.camera, background=background), target, after=self.after)


class Pictures:
    """The pictures of a scene at training size."""

    def __init__(
        self,
        scene: MultiviewScene,
        *,
        max_size: int | None = None,
        foreground: bool = False,
        background: str | None = None,
        picture_bytes: int = PICTURE_BYTES,
        target_bytes: int = TARGET_BYTES,
    ) -> None:
        """Read nothing yet.

        `max_size`: longest side in pixels; None: as they are. `foreground`: what the masks leave out becomes
        background. `background`: as in `TrainSettings`; pictures and cameras have the one of the scene unless it names
        a colour, and with RANDOM pictures must have alpha. `picture_bytes`, `target_bytes`: most memory that pictures
        in 8 bits and targets may hold; one of each is buffered whatever it takes.
        """
        self._scene = scene
        self._max_size = max_size
        self._foreground = foreground
        self._choice = background
        self.background = named_background(background) or scene.background
        self._exposure: Exposure = {}
        self._target_bytes = target_bytes
        self._stored = Recent(self._load, picture_bytes)
        self._targets = Recent(self._make_target, target_bytes)

    @property
    def exposure(self) -> Exposure:
        return self._exposure

    def with_exposure(self, exposure: Exposure) -> Pictures:
        """The same pictures as the average camera would have exposed them; those buffered in 8 bits are shared."""
        other = copy(self)
        other._exposure = dict(exposure)
        other._targets = Recent(other._make_target, self._target_bytes)
        return other

    @property
    def nbytes(self) -> int:
        return self._stored.nbytes + self._targets.nbytes

    def train(self, frame: int) -> list[View]:
        """The training views of a frame; their pictures are read when they are asked for."""
        return self._split(frame, held_out=False)

    def held_out(self, frame: int) -> list[View]:
        """The held-out views of a frame, as `train` gives them."""
        return self._split(frame, held_out=True)

    def view(self, frame: int, index: int) -> View:
        """The view of a shot, counted as those of its frame."""
        shot = self._scene.frames[frame][index]
        return View(self._scaled(shot.camera), Buffered(self._targets, (frame, index)), after=shot.after)

    def seen_by(self, camera: int, frame: int) -> View | None:
        """The view of a camera, counted as those of frame 0; None: it has no picture of the frame."""
        place = self._scene.place(frame, camera)
        return None if place is None else self.view(frame, place)

    def cameras(self) -> list[Camera]:
        """The cameras of the first frame at training size."""
        return [self._scaled(camera) for camera in self._scene.cameras]

    def check(self) -> None:
        """Read every training picture of the first frame, and the header of every other one.

        Raises SceneError for one that cannot be read or has a wrong size, and for a mask that is wanted and not there.
        """
        for frame, shots in enumerate(self._scene.frames):
            for index, shot in enumerate(shots):
                if frame == 0 and not shot.camera.held_out:
                    self._stored.get((frame, index))
                else:
                    shot.source.check(shot.size)
                    self._check_mask(shot)

    def _split(self, frame: int, held_out: bool) -> list[View]:
        shots = self._scene.frames[frame]
        return [self.view(frame, i) for i, s in enumerate(shots) if s.camera.held_out == held_out]

    def _scaled(self, camera: Camera) -> Camera:
        camera = replace(camera, background=self.background)
        longest = max(camera.width, camera.height)
        if self._max_size is None or longest <= self._max_size:
            return camera
        factor = self._max_size / longest
        return with_pixels(camera, max(1, round(camera.width * factor)), max(1, round(camera.height * factor)))

    def _make_target(self, key: _Key) -> Target:
        frame, index = key
        return self._stored.get(key).target(self._exposure.get(self._scene.frames[frame][index].camera.name))

    def _load(self, key: _Key) -> Stored:
        shot = self._scene.frames[key[0]][key[1]]
        data = shot.source.read(shot.size)
        mask = self._mask(shot)
        if mask is None and data.shape[2] == 3:
            if self._choice == RANDOM:
                raise SceneError(f"{shot.source}: expected alpha for random backgrounds, got an opaque picture")
            changes = self._changes(shot)
            return Stored(to_bytes(self._fitted(to_floats(data), shot)) if changes else np.ascontiguousarray(data))
        values = to_floats(data)
        rgb, alpha = values[..., :3], values[..., 3] if data.shape[2] == 4 else np.ones(data.shape[:2], np.float32)
        clear = 1 - (alpha if mask is None else alpha * mask)[..., None]
        whole = np.concatenate([(1 - clear) * rgb + clear * np.array(self.background, np.float32), clear], axis=2)
        fitted = to_bytes(self._fitted(whole, shot))
        return Stored(np.ascontiguousarray(fitted[..., :3]), np.ascontiguousarray(fitted[..., 3]))

    def _mask(self, shot: Shot) -> NDArray[np.float32] | None:
        """(H, W) of 0 and 1, the foreground; None where all of the picture is trained."""
        self._check_mask(shot)
        return read_mask(shot.mask, shot.size) if self._foreground and shot.mask else None

    def _check_mask(self, shot: Shot) -> None:
        if not self._foreground:
            return
        if shot.mask is None:
            raise SceneError(f"{shot.source}: expected a mask of the foreground, the scene has none")
        check_picture(shot.mask, shot.size)

    def _changes(self, shot: Shot) -> bool:
        camera = self._scaled(shot.camera)
        return shot.lens is not None or shot.size != (camera.width, camera.height)

    def _fitted(self, picture: NDArray[np.float32], shot: Shot) -> NDArray[np.float32]:
        """A picture (H, W, C) without its lens, at training size."""
        if shot.lens:
            picture = undistort(picture, shot.lens)
        camera = self._scaled(shot.camera)
        return resize(picture, camera.width, camera.height)


def pictures_for(scene: MultiviewScene, settings: TrainSettings) -> Pictures:
    """The pictures that a run with these settings is trained on."""
    masked = settings.foreground != OFF
    return Pictures(scene, max_size=settings.max_size, foreground=masked, background=settings.background)


Exposure = Mapping[str, Sequence[float]]  # camera -> gains r, g, b and offsets r, g, b


class Target:
    def __init__(self, rgb: NDArray[np.float32], clear: NDArray[np.float32] | None = None) -> None:
        """`rgb`: (H, W, 3), 0..1. `clear`: (H, W) share of the background in it; None: not known."""
        self.rgb = np.ascontiguousarray(rgb, np.float32)
        self.clear = clear
        self.moments: tuple[NDArray[np.float32], NDArray[np.float32]] | None = None  # (H, n), by `fit.losses.moments`
        self.on_device: Any = None  # a tensor of `rgb`, where the loss is computed on a device

    @property
    def rows(self) -> NDArray[np.float32]:
        return self.rgb.reshape(len(self.rgb), -1)

    def before(self, there: Background, now: Background) -> Target:
        """The picture before the background `now` instead of the one that is there. Raises ValueError without alpha."""
        if self.clear is None:
            raise ValueError("expected a picture whose background is known")
        change = np.subtract(now, there).astype(np.float32)
        return Target(self.rgb + self.clear[..., None] * change, self.clear)

    @property
    def nbytes(self) -> int:
        return 3 * self.rgb.nbytes + (0 if self.clear is None else self.clear.nbytes)

    def target(self) -> Target:
        return self


@dataclass(frozen=True, slots=True, eq=False)
class Stored:
    """A picture in 8 bits, 3 or 4 bytes a pixel, of which a target takes 36 or 40."""

    rgb: NDArray[np.uint8]  # (H, W, 3) before the background of the scene
    clear: NDArray[np.uint8] | None = None  # (H, W) share of the background in it; None: not known

    @property
    def nbytes(self) -> int:
        return self.rgb.nbytes + (0 if self.clear is None else self.clear.nbytes)

    def target(self, exposure: Sequence[float] | None) -> Target:
        """The picture in float32, as the average camera would have exposed it; None: exposed as it is."""
        rgb = to_floats(self.rgb)
        if exposure is not None:
            rgb = exposed_alike(rgb, exposure)
        return Target(rgb, None if self.clear is None else to_floats(self.clear))


def exposed_alike(picture: NDArray[np.float32], values: Sequence[float]) -> NDArray[np.float32]:
    """The picture (H, W, 3) as the average camera would have exposed it; colours may leave 0..1.

    `values`: gains and offsets of the camera that took it, as in `Exposure`.
    """
    gains, offsets = np.array(values, np.float32).reshape(2, 3)
    return (picture - offsets) / gains

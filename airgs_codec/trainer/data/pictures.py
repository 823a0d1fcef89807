"""The pictures of a multi-view scene as they are trained on, and plates: what a camera sees where nothing moves.

Pictures are undistorted, shrunk, masked and brought to one exposure. They are read when they are needed and buffered in
8 bits at training size; targets in float32 are made of them. Of both, those used last are buffered, within a bound.

The plate of a camera that stands still is the median of a few frames of the whole run, so that it is the same however
often a run is resumed, and has less noise than a picture. A pixel is at rest where the picture differs from the plate
by less than the camera's noise. Nothing is carried from frame to frame, so that slow drifts leave the plate, too.

H x W pixels, n = 3 W interleaved samples a row.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from airgs_codec._sampling import evenly_spaced
from airgs_codec.errors import SceneError
from airgs_codec.media.image import box_mean, check_picture, read_mask, resize, to_bytes, to_floats, undistort
from airgs_codec.render.cpu import Redraw
from airgs_codec.scene.camera import Background, Camera, with_pixels
from airgs_codec.trainer.data.multiview import MultiviewScene
from airgs_codec.trainer.settings import OFF, RANDOM, TrainSettings, named_background

# Bytes of pictures in 8 bits, 40 in 4K or 170 in 1080p, and of targets, 7 in 4K or 28 in 1080p.
MEMORY = PICTURE_BYTES, TARGET_BYTES = 1 << 30, 2 << 30

Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value", bound=Any)  # has its bytes as `nbytes`


class Recent(Generic[Key, Value]):
    """Values that are made on demand, of which those used last stay in memory."""

    def __init__(self, make: Callable[[Key], Value], most: int) -> None:
        """`most`: bytes of all; the newest value stays whatever it takes."""
        self._make, self._most = make, most
        self._values: OrderedDict[Key, Value] = OrderedDict()

    @property
    def nbytes(self) -> int:
        return sum(value.nbytes for value in self._values.values())

    def get(self, key: Key) -> Value:
        if key not in self._values:
            return self.put(key, self._make(key))
        self._values.move_to_end(key)
        return self._values[key]

    def put(self, key: Key, value: Value) -> Value:
        self._values[key] = value
        while len(self._values) > 1 and self.nbytes > self._most:
            self._values.popitem(last=False)
        return value


Exposure = Mapping[str, Sequence[float]]  # camera -> gains r, g, b and offsets r, g, b


class TargetPicture:
    def __init__(self, rgb: NDArray[np.float32], clear: NDArray[np.float32] | None = None) -> None:
        """`rgb`: (H, W, 3), 0..1. `clear`: (H, W) share of the background in it; None: not known."""
        self.rgb, self.clear = np.ascontiguousarray(rgb, np.float32), clear
        self.moments: tuple[NDArray[np.float32], NDArray[np.float32]] | None = None  # (H, n), by `fit.losses.moments`

    @property
    def rows(self) -> NDArray[np.float32]:
        return self.rgb.reshape(len(self.rgb), -1)

    @property
    def nbytes(self) -> int:
        return 3 * self.rgb.nbytes + (0 if self.clear is None else self.clear.nbytes)


@dataclass(frozen=True, slots=True, eq=False)
class View:
    camera: Camera
    picture: Any  # `TargetPicture`, or what reads it; or a tensor of it, where the loss is computed on a device
    redraw: Redraw | None = None  # None: the whole picture is drawn
    after: float = 0.0  # as in `Shot`

    @property
    def target(self) -> Any:
        """Return the picture; hold it no longer than needed. Raises SceneError where it cannot be read."""
        return self.picture() if callable(self.picture) else self.picture

    def before(self, background: Background) -> View:
        """Return the same before another background. Raises ValueError where the picture has no alpha."""
        shown = self.target
        if shown.clear is None:
            raise ValueError("expected a picture whose background is known")
        change = np.subtract(background, self.camera.background).astype(np.float32)
        target = TargetPicture(shown.rgb + shown.clear[..., None] * change, shown.clear)
        return View(replace(self.camera, background=background), target, after=self.after)


@dataclass(frozen=True, slots=True, eq=False)
class Plate:
    rgb: NDArray[np.uint8]  # (H, W, 3)
    noise: float  # standard deviation of a pixel, 0..1
    tolerance: float  # of the mean over WINDOW x WINDOW pixels, 0..1


Plates = Mapping[str, Plate]  # by the name of the camera


class Masks(Sequence[NDArray[np.bool_]]):
    """Masks (H, W), a bit a pixel."""

    def __init__(self, masks: Iterable[NDArray[np.bool_]]) -> None:
        self._packed = [(mask.shape, np.packbits(mask)) for mask in masks]

    def __len__(self) -> int:
        return len(self._packed)

    def __getitem__(self, index: Any) -> Any:
        shape, bits = self._packed[index]
        return np.unpackbits(bits, count=shape[0] * shape[1]).reshape(shape).astype(np.bool_)


@dataclass(frozen=True, slots=True, eq=False)
class FrameViews:
    """A frame and the views that it is fitted to."""

    frame: int
    views: Sequence[View]
    moving: Sequence[NDArray[np.bool_]] | None = None  # (H, W) of each view: not at rest now or a frame ago; None: any


class ScenePictures:
    """The pictures of a scene at training size, of one exposure, with plates where they are at rest."""

    def __init__(
        self, scene: MultiviewScene, settings: TrainSettings | None = None, memory: Sequence[int] = MEMORY
    ) -> None:
        """Read nothing yet; `memory`: bytes of pictures in 8 bits, and of targets."""
        self._scene, self._settings, self._target_bytes = scene, settings or TrainSettings(), memory[1]
        self.background = named_background(self._settings.background) or scene.background
        self.exposure: Exposure = {}
        self.plates: Plates = {}  # of every training camera; none: nothing is known to be at rest
        self._moving: dict[int, Masks] = {}  # of the last frame that was a target
        self._stored, self._targets = Recent(self._load, memory[0]), Recent(self._make_target, memory[1])

    def with_exposure(self, exposure: Exposure) -> ScenePictures:
        """Return the same pictures as the average camera would have exposed them; the buffer in 8 bits is shared."""
        other = copy(self)
        other.exposure, other._moving = dict(exposure), {}
        other._targets = Recent(other._make_target, self._target_bytes)
        return other

    def with_plates(self, plates: Sequence[Plate]) -> ScenePictures:
        """Return the same with what is at rest; `plates`: of every training camera, or none at all."""
        other, names = copy(self), [camera.name for camera in self._scene.cameras if not camera.held_out]
        other.plates, other._moving = dict(zip(names, plates, strict=True)) if plates else {}, {}
        return other

    @property
    def nbytes(self) -> int:
        return self._stored.nbytes + self._targets.nbytes

    def train(self, frame: int) -> list[View]:
        return [self.view(frame, i) for i, s in enumerate(self._scene.frames[frame]) if not s.camera.held_out]

    def held_out(self, frame: int) -> list[View]:
        return [self.view(frame, i) for i, s in enumerate(self._scene.frames[frame]) if s.camera.held_out]

    def target(self, frame: int, start: int) -> FrameViews:
        """Return a frame as it is fitted from the Gaussians of the frame `start`."""
        views, now = self.at_rest(frame)
        if now is None:
            return FrameViews(frame, views)
        before, seen = self._moving.get(start), self.train(start)
        if before is None:  # pictures of a frame that is past may be out of memory
            before = find_moving(seen, self.plates, self.exposure)
        self._moving = {frame: now}
        places = {view.camera.name: place for place, view in enumerate(seen)}  # a picture of the past may be missing
        pairs = ((mask, places.get(view.camera.name)) for mask, view in zip(now, views, strict=True))
        return FrameViews(frame, views, Masks(mask if i is None else mask | before[i] for mask, i in pairs))

    def at_rest(self, frame: int) -> tuple[list[View], Masks | None]:
        """Return the training views of a frame with their plates where they are at rest, and masks where not."""
        views = self.train(frame)
        return settle(views, self.plates, self.exposure) if self.plates else (views, None)

    def view(self, frame: int, index: int) -> View:
        shot = self._scene.frames[frame][index]
        return View(self._scaled(shot.camera), partial(self._targets.get, (frame, index)), after=shot.after)

    def seen_by(self, camera: int, frame: int) -> View | None:
        """Return the view of a camera, counted as those of frame 0; None: it has no picture of the frame."""
        place = self._scene.place(frame, camera)
        return None if place is None else self.view(frame, place)

    def cameras(self) -> list[Camera]:
        return [self._scaled(camera) for camera in self._scene.cameras]

    def check(self) -> None:
        """Read the training pictures of frame 0, and all headers. Raises SceneError for what cannot be used."""
        for frame, shots in enumerate(self._scene.frames):
            for index, shot in enumerate(shots):
                if frame == 0 and not shot.camera.held_out:
                    self._stored.get((frame, index))
                else:
                    shot.source.check(shot.size)
                if self._settings.foreground != OFF:
                    if shot.mask is None:
                        raise SceneError(f"{shot.source}: expected a mask of the foreground, the scene has none")
                    check_picture(shot.mask, shot.size)

    def _scaled(self, camera: Camera) -> Camera:
        size = camera.width, camera.height
        factor = min(1.0, (self._settings.max_size or max(size)) / max(size))
        return with_pixels(replace(camera, background=self.background), *(max(1, round(n * factor)) for n in size))

    def _make_target(self, key: tuple[int, int]) -> TargetPicture:
        stored, shot = self._stored.get(key), self._scene.frames[key[0]][key[1]]
        rgb = normalised(to_floats(stored[..., :3]), self.exposure.get(shot.camera.name))
        return TargetPicture(rgb, to_floats(stored[..., 3]) if stored.shape[2] == 4 else None)

    def _load(self, key: tuple[int, int]) -> NDArray[np.uint8]:
        """Return (H, W, 3) before the background; with alpha or a mask (H, W, 4), the last being its share."""
        shot = self._scene.frames[key[0]][key[1]]
        camera, data = self._scaled(shot.camera), shot.source.read(shot.size)
        mask = read_mask(shot.mask, shot.size) if self._settings.foreground != OFF and shot.mask else None
        opaque = data.shape[2] == 3
        plain = opaque and mask is None
        if plain and self._settings.background == RANDOM:
            raise SceneError(f"{shot.source}: expected alpha for random backgrounds, got an opaque picture")
        if plain and shot.lens is None and shot.size == (camera.width, camera.height):
            return np.ascontiguousarray(data)
        whole = to_floats(data)
        if not plain:
            rgb, alpha = whole[..., :3], np.ones(data.shape[:2], np.float32) if opaque else whole[..., 3]
            clear = 1 - (alpha if mask is None else alpha * mask)[..., None]
            whole = np.concatenate([(1 - clear) * rgb + clear * np.array(self.background, np.float32), clear], axis=2)
        if shot.lens:
            whole = undistort(whole, shot.lens)
        return to_bytes(resize(whole, camera.width, camera.height))


def normalised(picture: NDArray[np.float32], values: Sequence[float] | None) -> NDArray[np.float32]:
    """Return the picture (H, W, 3) as the average camera would have exposed it; `values`: as in `Exposure`."""
    if values is None:
        return picture
    gains, offsets = np.array(values, np.float32).reshape(2, 3)
    return (picture - offsets) / gains


WINDOW = 5  # pixels that differences are averaged over: noise goes, a shadow's edge stays


def stands_still(scene: MultiviewScene) -> bool:
    """Return whether every camera is one of those of frame 0 and as it was then; pictures may be missing."""
    first = {_pose(camera) for camera in scene.cameras}
    poses = ([_pose(shot.camera) for shot in shots] for shots in scene.frames)
    return all(len({name for name, *_ in one}) == len(one) and first.issuperset(one) for one in poses)


def _pose(c: Camera) -> tuple[Any, ...]:
    return c.name, *c.world_to_camera.ravel().tolist(), c.width, c.height, c.fx, c.fy, c.cx, c.cy


def plate_sources(scene: MultiviewScene) -> list[tuple[int, list[int]]]:
    """Return the training cameras that plates are taken from, as numbers, and the frames of each."""
    if len(scene) < 3 or not stands_still(scene):
        return []
    frames = evenly_spaced(len(scene), 16)
    return [(i, frames) for i, camera in enumerate(scene.cameras) if not camera.held_out]


def find_plate(pictures: ScenePictures, camera: int, frames: Sequence[int]) -> Plate:
    """Return the plate of one camera, as it exposed its pictures. Raises SceneError for one that cannot be read."""
    views = [pictures.seen_by(camera, frame) for frame in frames]
    return plate_of([to_bytes(view.target.rgb) for view in views if view])


def plate_of(pictures: Sequence[NDArray[np.uint8]]) -> Plate:
    """Return the plate of pictures (H, W, 3) of a camera: their lower median, which is a value that was seen."""
    middle = (len(pictures) - 1) // 2
    rgb = np.empty_like(pictures[0])
    for y in range(len(rgb)):  # row by row: a median of all at once takes a copy of all
        rgb[y] = np.partition(np.stack([picture[y] for picture in pictures]), middle, axis=0)[middle]
    differences = (to_floats(picture) - to_floats(rgb) for picture in pictures)
    noises = [float(np.median(np.abs(one - box_mean(one, WINDOW)))) / 0.6745 for one in differences]  # of a normal one
    noise = float(np.median(noises))
    # Four deviations of the mean of white noise, and twice that for codecs; more than 5 / 255 moves in any case.
    return Plate(rgb, noise, float(np.clip(8 / WINDOW * noise, 3 / 255, 5 / 255)))


def settle(views: Sequence[View], plates: Plates, exposure: Exposure) -> tuple[list[View], Masks]:
    """Return views with their plates where they are at rest, and masks where they are not (`find_moving`)."""

    def flatten(place: int) -> TargetPicture:
        target, rgb = views[place].target, _plate_of(views[place], plates, exposure)
        return TargetPicture(np.where(masks[place][..., None], target.rgb, rgb), target.clear)

    masks = find_moving(views, plates, exposure)
    buffer = Recent(flatten, TARGET_BYTES)
    return [replace(view, picture=partial(buffer.get, place)) for place, view in enumerate(views)], masks


def find_moving(views: Sequence[View], plates: Plates, exposure: Exposure) -> Masks:
    """Return masks of the pixels of views that are not at rest, and those right around them."""
    return Masks(_moving(v.target.rgb - _plate_of(v, plates, exposure), plates[v.camera.name]) for v in views)


def _plate_of(view: View, plates: Plates, exposure: Exposure) -> NDArray[np.float32]:
    return normalised(to_floats(plates[view.camera.name].rgb), exposure.get(view.camera.name))


def _moving(difference: NDArray[np.float32], plate: Plate) -> NDArray[np.bool_]:
    # The mean of a picture less its plate shows a shadow; that of absolute values moving texture, whose signs cancel.
    shade = np.abs(box_mean(difference, WINDOW)) > plate.tolerance
    texture = box_mean(np.abs(difference), WINDOW) > plate.noise + 2 * plate.tolerance
    red, green, blue = np.moveaxis(shade | texture, 2, 0)  # numpy reduces so short an axis forty times slower
    return box_mean((red | green | blue).astype(np.float32), 5) > 1e-6  # with what the Gaussians that move reach
